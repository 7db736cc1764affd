// What stands on the picture: whether it is live or recorded, how far to believe it, how far from physics it is.

import type { Player } from "../motion/player";
import { element, shortNumber } from "./dom";

export class Hud {
  readonly element: HTMLElement;
  readonly #mode = element("span", "chip");
  readonly #trust = element("span", "chip trust", ["covered by training"]);
  readonly #gap = element("span", "chip ghost");

  constructor() {
    this.#gap.hidden = true;
    this.element = element("div", "hud", [this.#mode, this.#trust, this.#gap]);
  }

  /** Say where the motion comes from. */
  showMode(player: Player): void {
    setText(this.#mode, player.isHeld ? "physics" : player.isLive ? "live" : "recorded");
  }

  /** Say how much of the motion training covered, 0 to 1; null is the true physics. */
  showTrust(trust: number | null): void {
    const isSure = trust === null || trust === 1;
    this.#trust.classList.toggle("doubt", !isSure);
    if (trust === null) {
      setText(this.#trust, "the true physics");
    } else {
      setText(this.#trust, isSure ? "covered by training" : `${Math.round(100 * trust)} % covered by training`);
    }
  }

  /** Say how far the physics beside it is [m]; null where there is none. */
  showGap(gap: number | null): void {
    this.#gap.hidden = gap === null;
    if (gap !== null) {
      setText(this.#gap, `physics: gap ${shortNumber(100 * gap)} cm`);
    }
  }
}

function setText(node: HTMLElement, text: string): void {
  if (node.textContent !== text) {
    node.textContent = text;
  }
}
