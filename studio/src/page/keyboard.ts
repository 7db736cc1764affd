// Keys: one table from key to action, and the keys held down to steer.

/** Return whether a key belongs to the focused element, not to the stage. */
function isTaken(event: KeyboardEvent): boolean {
  const target = event.target as HTMLElement;
  if (target.closest("dialog[open]")) {
    return true;
  }
  const isField = target.matches("input, select, textarea, [contenteditable]");
  const isPressed = target.matches("button, summary, a") && (event.key === " " || event.key === "Enter");
  return isField || isPressed;
}

/** Keys that steer while held down. */
export const STEERING_KEYS = ["ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", "PageUp", "PageDown"] as const;

export class Keyboard {
  readonly held = new Set<string>();

  /** `actions` are by key, prefixed by "Shift+" or "Ctrl+". */
  constructor(private readonly actions: Readonly<Record<string, () => void>>) {
    addEventListener("keydown", (event) => this.#down(event));
    addEventListener("keyup", (event) => this.held.delete(event.key));
    addEventListener("blur", () => this.held.clear());
  }

  #down(event: KeyboardEvent): void {
    if (isTaken(event) || event.altKey) {
      return;
    }
    const isControl = event.ctrlKey || event.metaKey;
    const isArrow = event.key.startsWith("Arrow");
    const prefix = `${isControl ? "Ctrl+" : ""}${event.shiftKey && isArrow ? "Shift+" : ""}`;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const action = this.actions[prefix + key];
    if (action) {
      event.preventDefault();
      action();
      return;
    }
    if (!prefix && (STEERING_KEYS as readonly string[]).includes(event.key)) {
      event.preventDefault();
      this.held.add(event.key);
    }
  }
}
