// What stands on the picture: whether it is live or recorded, how far to believe it, how far from physics it is.

import type { Bundle } from "../bundle/bundle";
import { EDGE } from "../motion/motion";
import type { Player } from "../motion/player";
import { element, shortNumber } from "./dom";

/** How good an emulator is where it was trained, if that is known. */
type Verdict = Bundle["verdict"];

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

  /**
   * Say how far the motion lies from what training showed, 1 is the edge, and how good the emulator is within;
   * a score of null is the true physics.
   */
  showTrust(score: number | null, verdict: Verdict): void {
    const isWithin = score === null || score <= EDGE;
    const isUseless = score !== null && verdict?.word === "useless";
    this.#trust.classList.toggle("doubt", !isWithin || isUseless);
    this.#trust.title = score === null || !verdict ? "" : `Where it was trained the emulator is ${verdict.word}: ${verdict.reasons}`;
    if (score === null) {
      setText(this.#trust, "the true physics");
    } else if (isWithin) {
      setText(this.#trust, verdict ? `covered by training, ${verdict.word} there` : "covered by training");
    } else {
      setText(this.#trust, score < FAR ? `${shortNumber(score)} × the edge of training` : "far beyond training");
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
