// The row of systems at the top.

import type { CatalogueEntry } from "../bundle/catalogue";
import { nameOf } from "../bundle/bundle";
import { element } from "../page/dom";

/** Numbers of physics steps in a super step of the shipped emulators. */
const USUAL = [50, 40, 32, 64];

export class Picker {
  readonly element = element("nav", "picker");
  readonly #buttons = new Map<string, HTMLButtonElement>();

  constructor(private readonly onPick: (entry: CatalogueEntry) => void) {
    this.element.setAttribute("aria-label", "Systems");
  }

  /** Add an emulator to choose from. */
  add(entry: CatalogueEntry): void {
    if (this.#buttons.has(entry.id)) {
      return;
    }
    const made = element("button", "", [labelOf(entry)]);
    made.type = "button";
    made.title = `${nameOf(entry)}: ${entry.about}`;
    made.dataset["id"] = entry.id;
    made.addEventListener("click", () => this.onPick(entry));
    this.#buttons.set(entry.id, made);
    this.element.append(made);
  }

  /** Mark the one on the stage. */
  select(id: string): void {
    this.#buttons.forEach((made, key) => made.setAttribute("aria-current", String(key === id)));
    this.#buttons.get(id)?.scrollIntoView({ block: "nearest", inline: "nearest" });
  }
}

/** The system's name for the shipped ones; the file's own for others. */
function labelOf(entry: CatalogueEntry): string {
  const isUsual = entry.id === entry.system || USUAL.some((substeps) => entry.id === `${entry.system}-${substeps}`);
  const name = isUsual ? entry.system : nameOf(entry);
  return name.charAt(0).toUpperCase() + name.slice(1);
}
