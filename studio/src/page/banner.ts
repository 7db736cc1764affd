// Lines that say what happened and what to do; they stay until they are no longer true or are closed.

import { button, element } from "./dom";

export type Severity = "info" | "warning" | "error";

/** A remedy, on a button. */
export interface Action {
  readonly label: string;
  act(): void;
}

export class Banners {
  readonly element = element("div", "banners");
  readonly #lines = new Map<string, { row: HTMLElement; text: HTMLElement }>();

  constructor() {
  }

  /** Show a line about `topic`; another one about it replaces it. */
  say(topic: string, line: string, severity: Severity = "info", action?: Action): void {
    const present = this.#lines.get(topic);
    if (present) {
      present.row.className = `banner ${severity}`;
      if (present.text.textContent !== line) {
        present.text.textContent = line;
      }
      return;
    }
    const text = element("span", "", [line]);
    const close = button({ label: "×", title: "Close this message", onClick: () => this.clear(topic) });
    const buttons = action ? [button({ label: action.label, onClick: () => action.act() }), close] : [close];
    const row = element("div", `banner ${severity}`, [text, element("span", "row", buttons)]);
    row.setAttribute("role", severity === "error" ? "alert" : "status");
    this.#lines.set(topic, { row, text });
    this.element.append(row);
  }

  /** Show a line that disappears by itself. */
  tell(line: string, severity: Severity = "info"): void {
    this.say("passing", line, severity);
    setTimeout(() => {
      if (this.#lines.get("passing")?.text.textContent === line) {
        this.clear("passing");
      }
    }, 5000);
  }

  clear(topic: string): void {
    this.#lines.get(topic)?.row.remove();
    this.#lines.delete(topic);
  }
}

/** Return an error as one line. */
export function lineOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
