// What stands on the picture: whether it is live or recorded, how far to believe it, how far from physics it is.

import { EDGE } from "../motion/motion";
import type { Player } from "../motion/player";
import { element, shortNumber } from "./dom";

/** Scores from here on are all alike: nothing is known there. */
const FAR = 10;

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
    setText(this.#mode, player.motion.source === "physics" ? "physics" : player.isLive ? "live" : "recorded");
  }

  /** Say how far the motion lies from what training showed, 1 is the edge; null is the true physics. */
  showTrust(score: number | null): void {
    const isSure = score === null || score <= EDGE;
    this.#trust.classList.toggle("doubt", !isSure);
    if (score === null) {
      setText(this.#trust, "the true physics");
    } else {
      setText(this.#trust, isSure ? "covered by training" : score < FAR ? `${shortNumber(score)} × the edge of training` : "far beyond training");
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
