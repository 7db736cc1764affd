// A small curve over time: the gap, the trust, an objective over iterations.

import { element } from "../page/dom";

export interface Series {
  readonly values: ArrayLike<number>;
  /** Custom property of the style sheet, such as --accent. */
  readonly colour: string;
}

export class Curve {
  readonly element: HTMLElement;
  readonly #canvas = element("canvas", "curve");
  readonly #note = element("span", "curve-note");

  constructor(title: string) {
    this.#canvas.setAttribute("role", "img");
    this.#canvas.setAttribute("aria-label", title);
    const head = element("div", "curve-head", [element("span", "", [title]), this.#note]);
    this.element = element("div", "curve-box", [head, this.#canvas]);
  }

  /** Text beside the title. */
  set note(text: string) {
    if (this.#note.textContent !== text) {
      this.#note.textContent = text;
    }
  }

  /** Draw series over a common width of `length` values, from `low` to `high`; a playhead at `at`, 0 to 1, if not negative. */
  draw(series: readonly Series[], length: number, low: number, high: number, at = -1): void {
    const ratio = Math.min(window.devicePixelRatio, 2);
    const width = Math.round(this.#canvas.clientWidth * ratio);
    const height = Math.round(this.#canvas.clientHeight * ratio);
    if (width === 0 || height === 0) {
      return;
    }
    if (this.#canvas.width !== width || this.#canvas.height !== height) {
      this.#canvas.width = width;
      this.#canvas.height = height;
    }
    const context = this.#canvas.getContext("2d")!;
    const style = getComputedStyle(this.#canvas);
    context.clearRect(0, 0, width, height);
    context.lineWidth = 1.5 * ratio;
    context.lineJoin = "round";
    for (const { values, colour } of series) {
      context.strokeStyle = style.getPropertyValue(colour) || "currentColor";
      context.beginPath();
      const stride = Math.max(1, Math.floor(values.length / width));
      for (let i = 0; i < values.length; i += stride) {
        const x = (i / Math.max(length - 1, 1)) * width;
        const share = (values[i]! - low) / Math.max(high - low, 1e-12);
        const y = height - ratio - share * (height - 2 * ratio);
        context.lineTo(x, Math.min(Math.max(y, 0), height));
      }
      context.stroke();
    }
    if (at >= 0) {
      context.strokeStyle = style.color;
      context.globalAlpha = 0.5;
      context.lineWidth = ratio;
      context.beginPath();
      context.moveTo(at * width, 0);
      context.lineTo(at * width, height);
      context.stroke();
      context.globalAlpha = 1;
    }
  }
}
