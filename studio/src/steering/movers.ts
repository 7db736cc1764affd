// Movers of a soft body: led by a hand or by keys, or wandering along their initial paths when left alone.

import type { Bundle, MoverFacts } from "../bundle/bundle";
import type { Motion } from "../motion/motion";
import type { Pilot } from "../motion/player";
import { clamp } from "./pilots";

/** Approximate time in which a mover reaches its target, if it is fast enough [s]. */
const RESPONSE = 0.2;

/** Time constant with which a mover reaches a velocity [s], as in training paths (systems/movers.py). */
const INERTIA = 0.1;

/** Time alone after which movers wander again [s]. */
const REST = 4;

/** Share of its bounds with which a mover gently returns to its path. */
const RETURN = 0.4;

type Place = [number, number, number];

/** The closed paths of wandering movers: those of a motion that ends where it began. */
export class WanderPath {
  readonly steps: number;
  readonly #controls: Float32Array;
  /** States (steps + 1, S), of which movers' positions count. */
  readonly #states: Float32Array;

  constructor(
    motion: Motion,
    private readonly facts: Bundle,
  ) {
    this.steps = motion.steps;
    this.#controls = motion.controls();
    this.#states = motion.states();
  }

  /** The control (C) of super step `step`, as a view. */
  control(step: number): Float32Array {
    const size = this.facts.control_low.length;
    const within = step % this.steps;
    return this.#controls.subarray(within * size, (within + 1) * size);
  }

  /** The state (S) in which super step `step` begins, as a view. */
  state(step: number): Float32Array {
    const size = this.facts.rest.length;
    const within = step % this.steps;
    return this.#states.subarray(within * size, (within + 1) * size);
  }

  /** Return the super step at which movers are nearest to those in `state` (S). */
  nearest(state: ArrayLike<number>): number {
    let nearest = 0;
    let least = Infinity;
    for (let step = 0; step < this.steps; step++) {
      const there = this.state(step);
      let square = 0;
      for (const mover of this.facts.movers ?? []) {
        for (const away of wayBetween(mover, state, there)) {
          square += away ** 2;
        }
      }
      if (square < least) {
        least = square;
        nearest = step;
      }
    }
    return nearest;
  }
}

/** Return the way of a mover from a state (S) to another: metres, and radians about Z, or about its own axes if it turns freely. */
function wayBetween([, entry, , size]: MoverFacts, from: ArrayLike<number>, to: ArrayLike<number>): number[] {
  const straight = size > 4 ? 3 : size;
  const way = Array.from({ length: straight }, (_, axis) => to[entry + axis]! - from[entry + axis]!);
  if (straight === size) {
    return way;
  }
  const [a, b, c, d] = [0, 1, 2, 3].map((i) => from[entry + 3 + i]!) as [number, number, number, number];
  const [w, x, y, z] = [0, 1, 2, 3].map((i) => to[entry + 3 + i]!) as [number, number, number, number];
  const sign = a * w + b * x + c * y + d * z < 0 ? -2 : 2;
  way.push(sign * (a * x - b * w - c * z + d * y), sign * (a * y + b * z - c * w - d * x), sign * (a * z - b * y + c * x - d * w));
  return way;
}

export class MoverPilot implements Pilot {
  /** Number of the mover that keys move: the last one grabbed. */
  chosen = 0;
  readonly #movers: readonly MoverFacts[];
  readonly #control: Float32Array;
  /** The control of the super step before. */
  readonly #before: Float32Array;
  /** Target of the led mover [m]. */
  #target: Place | null = null;
  #velocity: Place | null = null;
  /** Time since a mover was last led [s]. */
  #alone = Infinity;
  /** Current super step of the path; null until it is reached. */
  #step: number | null = null;

  constructor(
    private readonly facts: Bundle,
    private readonly path: WanderPath,
  ) {
    this.#movers = facts.movers ?? [];
    this.#control = new Float32Array(facts.control_low.length);
    this.#before = this.#control.slice();
  }

  /** Lead a mover to a place [m], as fast as it may go. */
  lead(mover: number, target: ArrayLike<number>): void {
    this.chosen = mover;
    this.#target = [target[0]!, target[1]!, target[2]!];
  }

  /** Move the chosen mover with a velocity, in shares of its bounds; null lets go of it. */
  push(velocity: ArrayLike<number> | null): void {
    this.#velocity = velocity && [velocity[0]!, velocity[1]!, velocity[2]!];
  }

  /** Let go: movers stop, and wander again after a while. */
  release(): void {
    this.#target = null;
  }

  /** Let movers wander now. */
  wander(): void {
    this.release();
    this.#alone = Infinity;
  }

  get isWandering(): boolean {
    return this.#alone > REST;
  }

  control(state: Float32Array): Float32Array {
    this.#before.set(this.#control);
    this.#control.fill(0);
    if (this.#target || this.#velocity) {
      this.#alone = 0;
      this.#step = null;
      this.#obey(state);
    } else {
      this.#alone += this.facts.dt;
      if (this.isWandering && this.path.steps > 0) {
        this.#follow(state);
      }
    }
    if (this.#step === null) {
      this.#ease();
    }
    return this.#control;
  }

  // Training has not shown jolts.
  #ease(): void {
    const share = 1 - Math.exp(-this.facts.dt / INERTIA);
    this.#before.forEach((before, i) => (this.#control[i] = before + share * (this.#control[i]! - before)));
  }

  #obey(state: Float32Array): void {
    const [, entry, first] = this.#movers[this.chosen]!;
    for (let axis = 0; axis < 3; axis++) {
      const high = this.facts.control_high[first + axis]!;
      const wanted = this.#target ? (this.#target[axis]! - state[entry + axis]!) / Math.max(RESPONSE, this.facts.dt) : this.#velocity![axis]! * high;
      this.#set(first + axis, wanted, 1);
    }
  }

  // Along the path once it is reached, and to its nearest point until then.
  #follow(state: Float32Array): void {
    const step = (this.#step ??= this.path.nearest(state));
    const there = this.path.state(step);
    const control = this.path.control(step);
    let isThere = true;
    for (const mover of this.#movers) {
      const first = mover[2];
      wayBetween(mover, state, there).forEach((away, axis) => {
        const nearly = 2 * this.facts.dt * this.facts.control_high[first + axis]!;
        isThere &&= Math.abs(away) < nearly;
        this.#set(first + axis, away / (4 * RESPONSE), RETURN);
      });
    }
    this.#step = isThere ? step + 1 : null;
    if (isThere) {
      control.forEach((value, i) => this.#set(i, this.#control[i]! + value, 1));
    }
  }

  /** Set a number of the control, within a `share` of its bounds. */
  #set(entry: number, value: number, share: number): void {
    this.#control[entry] = clamp(value, share * this.facts.control_low[entry]!, share * this.facts.control_high[entry]!);
  }
}
