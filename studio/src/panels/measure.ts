// The emulator's cost, its distance from physics, and how far to trust it.

import { emptyPose, poseBones } from "../body/pose";
import { surfaceGap, surfaceOf } from "../body/surface";
import { isPhysics } from "../bundle/bundle";
import { EDGE, type Motion } from "../motion/motion";
import { button, element, fact, panel, shortNumber, type Fact } from "../page/dom";
import type { Session } from "../page/session";
import type { Twin } from "../physics/twin";
import type { Panel } from "./controls";
import { Curve } from "./curve";

/** Number of super steps over which scores are averaged, against flicker. */
const TRUST_WINDOW = 10;

/** Score above which the curve is drawn at the top. */
const TOP_SCORE = 3;

/** Minimum interval between updates of numbers and curves [ms]. */
const INTERVAL = 250;

/** Return the mean distance of two motions' bones [m], or the rms distance of a surface's nodes, super step by super step. */
export function gapsBetween(session: Session, one: Motion, other: Motion, from: number, to: number): number[] {
  if (session.facts.surface) {
    const surface = surfaceOf(session.facts.surface);
    return Array.from({ length: to - from }, (_, i) => surfaceGap(surface, one.state(from + i), other.state(from + i)));
  }
  const { skeleton } = session.facts;
  const { bones } = session.world;
  const a = emptyPose(skeleton.length);
  const b = emptyPose(skeleton.length);
  const gaps: number[] = [];
  for (let step = from; step < to; step++) {
    poseBones(skeleton, one.state(step), a);
    poseBones(skeleton, other.state(step), b);
    let sum = 0;
    for (const bone of bones) {
      const [x, y, z] = [0, 1, 2].map((axis) => a.positions[3 * bone + axis]! - b.positions[3 * bone + axis]!);
      sum += Math.hypot(x!, y!, z!);
    }
    gaps.push(sum / bones.length);
  }
  return gaps;
}

/** Return the mean score of the last super steps up to `step`. */
function scoreAt(motion: Motion, step: number): number {
  let sum = 0;
  let count = 0;
  for (let i = Math.max(0, step - TRUST_WINDOW + 1); i <= step && i < motion.steps; i++) {
    sum += motion.score(i);
    count += 1;
  }
  return count === 0 ? 0 : sum / count;
}

export class MeasurePanel implements Panel {
  readonly element: HTMLElement;
  /** The gap at the playhead [m], or null before physics gets there. */
  gap: number | null = null;
  readonly #step: Fact;
  readonly #work: Fact;
  readonly #speedUp = fact("times faster than physics here");
  readonly #gap = new Curve("gap to physics");
  readonly #trust = new Curve("trust: 1 is the edge of training");
  readonly #ghost: HTMLButtonElement;
  #gaps: number[] = [];
  #of: Motion | null = null;
  #scores: number[] = [];
  #scoresOf: Motion | null = null;
  #waited = Infinity;
  #last = performance.now();

  constructor(
    private readonly session: Session,
    private readonly twin: Twin | null,
    noPhysics: string,
    onGhost: () => void,
  ) {
    const { details, body } = panel("Measure", true);
    const model = isPhysics(session.facts) ? "physics" : "emulator";
    this.#step = fact(`a super step of the ${model}`);
    this.#work = fact(`the ${model}'s time per frame`);
    this.element = details;
    this.#ghost = button({ label: "Physics as a ghost", title: "Show the true physics beside the emulator (G)", onClick: onGhost });
    this.#ghost.disabled = twin === null;
    const micro = 1e6 * session.secondsPerStep;
    this.#step.value.textContent = `${shortNumber(micro)} µs for ${shortNumber(1000 * session.facts.dt)} ms`;
    if (isPhysics(session.facts)) {
      const facts = element("dl", "facts", [this.#step.row, this.#work.row]);
      body.append(element("p", "", ["This is the true physics, computed in the page: it costs less than an emulator of it."]), facts);
      return;
    }
    const facts = element("dl", "facts", [this.#step.row, this.#work.row, this.#speedUp.row]);
    body.append(element("div", "row", [this.#ghost]), facts, this.#gap.element, this.#trust.element);
    if (!twin) {
      body.append(element("p", "", [noPhysics]));
    }
  }

  /** Distance of the last super steps before the playhead from the training data: 1 is the edge. */
  get score(): number {
    const { player } = this.session;
    return scoreAt(player.motion, player.step);
  }

  update(): void {
    const { player } = this.session;
    this.#followGap();
    this.#followTrust();
    this.#ghost.setAttribute("aria-pressed", String(this.twin?.isOn ?? false));
    // Numbers that change with every image cannot be read.
    const now = performance.now();
    this.#waited += now - this.#last;
    this.#last = now;
    if (this.#waited < INTERVAL || !(this.element as HTMLDetailsElement).open) {
      return;
    }
    this.#waited = 0;
    const length = player.motion.steps + 1;
    const at = player.motion.duration > 0 ? player.time / player.motion.duration : 0;
    const largest = this.#gaps.reduce((most, gap) => Math.max(most, gap), 0.05 * this.session.world.size);
    this.#gap.draw([{ values: this.#gaps, colour: "--ghost" }], length, 0, largest, at);
    this.#gap.note = this.gap === null ? "–" : `${shortNumber(100 * this.gap)} cm of ${shortNumber(100 * this.session.world.size)}`;
    const edge = { values: new Float32Array(length).fill(EDGE), colour: "--doubt" };
    const top = this.#scores.reduce((most, score) => Math.max(most, score), 1.5 * EDGE);
    this.#trust.draw([edge, { values: this.#scores, colour: "--accent" }], length, 0, Math.min(top, TOP_SCORE), at);
    this.#trust.note = this.score.toFixed(2);
    const { school, crowd, walkers } = this.session;
    const others = school ?? crowd ?? walkers;
    const work = player.workPerImage + (others?.workPerImage ?? 0);
    this.#work.value.textContent = player.isLive || others ? `${work.toFixed(2)} ms` : "–";
    const cost = this.twin?.cost;
    if (cost) {
      const own = this.session.secondsPerStep / this.session.facts.dt;
      this.#speedUp.value.textContent = `${shortNumber(cost / own)} ×`;
    }
  }

  #followGap(): void {
    const { player } = this.session;
    const physics = this.twin?.isOn ? this.twin.motion : null;
    if (!physics || this.#of !== player.motion) {
      this.#gaps = [];
      this.#of = player.motion;
    }
    this.gap = null;
    if (!physics) {
      return;
    }
    const known = Math.min(physics.steps, player.motion.steps) + 1;
    if (this.#gaps.length < known) {
      this.#gaps.push(...gapsBetween(this.session, player.motion, physics, this.#gaps.length, known));
    }
    this.gap = this.#gaps[Math.min(Math.round(player.time / player.motion.dt), this.#gaps.length - 1)] ?? null;
  }

  #followTrust(): void {
    const { motion } = this.session.player;
    if (this.#scoresOf !== motion) {
      this.#scores = [];
      this.#scoresOf = motion;
    }
    while (this.#scores.length < motion.steps) {
      this.#scores.push(motion.score(this.#scores.length));
    }
  }
}
