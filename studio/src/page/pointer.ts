// The pointer on the stage: things under it may take its drag before the camera does.

/** Something that can be grabbed. Places are -1 to 1 across the picture, and up. */
export interface Grabbable {
  /** The pointer went down; return true to take its drag. */
  grab(x: number, y: number): boolean;
  /** The grabbed pointer moved; `isLevel` asks to stay at one height. */
  drag(x: number, y: number, isLevel: boolean): void;
  /** The wheel was turned by `pixels`, toward the user, while it was held. */
  wheel?(pixels: number): void;
  release(): void;
}

/** Maximum motion of the pointer between press and release in a tap [pixels]. */
const STILL = 5;

export class Pointer {
  #held: Grabbable | null = null;
  #pressed: readonly [x: number, y: number] | null = null;

  /** `candidates` are tried in order; `onHold` is called with whether one has the pointer, `onTap` with a tap that none took. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly candidates: () => readonly Grabbable[],
    private readonly onHold: (isHeld: boolean) => void,
    private readonly onTap: (x: number, y: number) => void,
  ) {
    // Before the camera's own listeners: grabbing a body does not turn the camera.
    canvas.addEventListener("pointerdown", (event) => this.#down(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this.#held?.drag(...this.#place(event), event.shiftKey));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { capture: true, passive: false });
    canvas.addEventListener("pointerup", (event) => this.#up(event));
    canvas.addEventListener("pointercancel", () => this.release());
  }

  /** Release what is held. */
  release(): void {
    if (this.#held) {
      this.#held.release();
      this.#held = null;
      this.canvas.classList.remove("pushing");
      this.onHold(false);
    }
  }

  #down(event: PointerEvent): void {
    if (event.button !== 0 || !event.isPrimary) {
      return;
    }
    const place = this.#place(event);
    this.#held = this.candidates().find((candidate) => candidate.grab(...place)) ?? null;
    this.#pressed = this.#held ? null : [event.clientX, event.clientY];
    if (this.#held) {
      event.stopImmediatePropagation();
      this.canvas.setPointerCapture(event.pointerId);
      this.canvas.classList.add("pushing");
      this.onHold(true);
    }
  }

  #up(event: PointerEvent): void {
    this.release();
    const pressed = this.#pressed;
    this.#pressed = null;
    if (pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < STILL) {
      this.onTap(...this.#place(event));
    }
  }

  #wheel(event: WheelEvent): void {
    if (this.#held?.wheel) {
      event.preventDefault();
      event.stopImmediatePropagation();
      this.#held.wheel(event.deltaY);
    }
  }

  #place(event: PointerEvent): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    return [(2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height];
  }
}
