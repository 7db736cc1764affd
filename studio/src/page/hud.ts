// The labels on the picture: live or recorded, how far to trust it, and its distance from physics.

import type { Bundle } from "../bundle/bundle";
import { EDGE } from "../motion/motion";
import type { Player } from "../motion/player";
import { element, shortNumber } from "./dom";

/** The quality of an emulator where it was trained, if known. */
type Verdict = Bundle["verdict"];

/** Score above which all count alike: nothing is known there. */
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

  /** Show the source of the motion. */
  showMode(player: Player): void {
    setText(this.#mode, player.motion.source === "physics" ? "physics" : player.isRecorded ? "falls and gets up, as recorded on the physics" : player.isLive ? "live" : "recorded");
  }

  /**
   * Show the distance of the motion from the training data, 1 is the edge, and the emulator's quality within;
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

  /** Show the distance of the physics beside it [m]; null without physics. */
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
