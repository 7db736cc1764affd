// Lines that say what happened and what to do; they stay until they are no longer true or are closed.

import { button, element } from "./dom";

export type Severity = "info" | "warning" | "error";

/** A remedy, on a button. */
export interface Action {
  readonly label: string;
  act(): void;
}

/** A place for lines. */
export interface Notices {
  /** Show a line about `topic`; another one about it replaces it. */
  say(topic: string, line: string, severity?: Severity, action?: Action): void;
  /** Show a line that disappears by itself. */
  tell(line: string, severity?: Severity): void;
  clear(topic: string): void;
}

/** Lines about one system on show: they leave with it, and nothing is said of it afterwards. */
export class PassingNotices implements Notices {
  readonly #topics = new Set<string>();
  #isOver = false;

  constructor(private readonly banners: Notices) {}

  say(topic: string, line: string, severity?: Severity, action?: Action): void {
    if (!this.#isOver) {
      this.#topics.add(topic);
      this.banners.say(topic, line, severity, action);
    }
  }

  tell(line: string, severity?: Severity): void {
    if (!this.#isOver) {
      this.banners.tell(line, severity);
    }
  }

  clear(topic: string): void {
    this.banners.clear(topic);
  }

  end(): void {
    this.#topics.forEach((topic) => this.banners.clear(topic));
    this.#isOver = true;
  }
}

export class Banners implements Notices {
  readonly element = element("div", "banners");
  readonly #lines = new Map<string, { row: HTMLElement; text: HTMLElement }>();

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
