// Elements of the page. Text is set as text and never as markup: names may come from strangers.

import { DEGREES } from "../body/heading";

type Children = readonly (Node | string)[];

/** Return a new element with a class and children. */
export function element<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  className = "",
  children: Children = [],
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  if (className) {
    made.className = className;
  }
  made.append(...children);
  return made;
}

export interface ButtonOptions {
  readonly label: string;
  /** What it does, as a tooltip and for screen readers. */
  readonly title?: string;
  readonly className?: string;
  onClick(): void;
}

/** Return a button. */
export function button(options: ButtonOptions): HTMLButtonElement {
  const made = element("button", options.className ?? "", [options.label]);
  made.type = "button";
  if (options.title !== undefined) {
    made.title = options.title;
    made.setAttribute("aria-label", options.title);
  }
  made.addEventListener("click", () => options.onClick());
  return made;
}

/** Set whether a toggle button is pressed. */
export function setPressed(made: HTMLButtonElement, isPressed: boolean): void {
  made.setAttribute("aria-pressed", String(isPressed));
}

export interface SliderOptions {
  readonly label: string;
  /** Unit of its numbers; angles [rad] are shown in degrees. */
  readonly unit: string;
  readonly low: number;
  readonly high: number;
  readonly value: number;
  /** The number that is 100 %, for those without a unit. */
  readonly full?: number;
  onInput(value: number): void;
}

export interface Slider {
  readonly row: HTMLElement;
  value: number;
}

/** Return a labelled slider that shows its number. */
export function slider(options: SliderOptions): Slider {
  const input = element("input");
  input.type = "range";
  input.min = String(options.low);
  input.max = String(options.high);
  input.step = String((options.high - options.low) / 200);
  input.value = String(options.value);
  const shown = element("output");
  const show = (): void => {
    const value = Number(input.value);
    if (options.unit === "rad") {
      shown.textContent = `${(DEGREES * value).toFixed(0)}°`;
    } else if (options.full !== undefined) {
      shown.textContent = `${((100 * value) / options.full).toFixed(0)} %`;
    } else {
      shown.textContent = `${shortNumber(value)} ${options.unit}`;
    }
  };
  show();
  input.addEventListener("input", () => {
    show();
    options.onInput(Number(input.value));
  });
  const row = element("label", "slider", [element("span", "", [options.label]), input, shown]);
  return {
    row,
    get value() {
      return Number(input.value);
    },
    set value(value: number) {
      if (document.activeElement !== input) {
        input.value = String(value);
        show();
      }
    },
  };
}

/** Return a number with a useful number of digits. */
export function shortNumber(value: number): string {
  const size = Math.abs(value);
  if (size >= 1000) {
    return value.toFixed(0);
  }
  if (size >= 100) {
    return value.toFixed(0);
  }
  return value.toFixed(size >= 10 ? 1 : 2);
}

/** Return a panel that opens and closes, with its body. */
export function panel(title: string, isOpen: boolean): { details: HTMLDetailsElement; body: HTMLElement } {
  const body = element("div", "panel-body");
  const details = element("details", "panel", [element("summary", "", [title]), body]);
  details.open = isOpen;
  return { details, body };
}

/** A row with a name and a value that changes. */
export interface Fact {
  readonly row: HTMLElement;
  readonly value: HTMLElement;
}

/** Return a row of a name and a value; set the text of `value` later. */
export function fact(name: string): Fact {
  const value = element("dd", "", ["–"]);
  return { row: element("div", "fact", [element("dt", "", [name]), value]), value };
}
