// What moves a soft body: movers led by a hand or by keys, and left alone wandering along the paths they are first shown on.

import type { Bundle, MoverFacts } from "../bundle/bundle";
import type { Motion } from "../motion/motion";
import type { Pilot } from "../motion/player";
import { clamp } from "./pilots";

/** A mover goes to where it is led in about this time, if it is quick enough [s]. */
const RESPONSE = 0.2;

/** Time constant at which a mover takes up a velocity [s]: that of the paths emulators are trained on (systems/soft/movers.py). */
const INERTIA = 0.1;

/** Left alone for so long, movers wander again [s]. */
const REST = 4;

/** Share of its bounds with which a mover goes back to its path: nobody should be startled. */
const RETURN = 0.4;

type Place = [number, number, number];

/** The paths that movers wander along, over and over: those of a motion that ends where it began. */
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

  /** Return the super step at which movers are nearest to where they are in `state` (S). */
  nearest(state: ArrayLike<number>): number {
    let nearest = 0;
    let least = Infinity;
    for (let step = 0; step < this.steps; step++) {
      const there = this.state(step);
      let square = 0;
      for (const [, entry, , size] of this.facts.movers ?? []) {
        for (let i = entry; i < entry + size; i++) {
          square += (there[i]! - state[i]!) ** 2;
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

export class MoverPilot implements Pilot {
  /** The mover that keys move, by its number: the last one taken hold of. */
  chosen = 0;
  readonly #movers: readonly MoverFacts[];
  readonly #control: Float32Array;
  /** The control of the super step before. */
  readonly #before: Float32Array;
  /** Where a mover is led to [m]. */
  #target: Place | null = null;
  #velocity: Place | null = null;
  /** Time since somebody last led a mover [s]. */
  #alone = Infinity;
  /** The super step of the path that is followed; null while it is not reached. */
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

  // A jolt is nothing that training has shown.
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

  // Along the path, once it is reached; and wherever it is nearest until then.
  #follow(state: Float32Array): void {
    const step = (this.#step ??= this.path.nearest(state));
    const there = this.path.state(step);
    const control = this.path.control(step);
    let isThere = true;
    for (const [, entry, first, size] of this.#movers) {
      for (let axis = 0; axis < size; axis++) {
        const away = there[entry + axis]! - state[entry + axis]!;
        const nearly = 2 * this.facts.dt * this.facts.control_high[first + axis]!;
        isThere &&= Math.abs(away) < nearly;
        this.#set(first + axis, away / (4 * RESPONSE), RETURN);
      }
    }
    this.#step = isThere ? step + 1 : null;
    if (isThere) {
      control.forEach((value, i) => this.#set(i, this.#control[i]! + value, 1));
    }
  }

  /** Set a number of the control, within so much of its bounds. */
  #set(entry: number, value: number, share: number): void {
    this.#control[entry] = clamp(value, share * this.facts.control_low[entry]!, share * this.facts.control_high[entry]!);
  }
}
