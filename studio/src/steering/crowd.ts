// A crowd: many soft bodies of a kind in rows around the one on show, whose movers wander at various phases of the path.

import type { Bundle } from "../bundle/bundle";
import type { Batch, Emulator } from "../emulator/emulator";
import { interpolateHermite, type StateStructure } from "../motion/interpolate";
import type { WanderPath } from "./movers";

/** Number of bodies in a group, computed side by side. Groups take turns, so that every image has the same work. */
const GROUP = 16;

/** Maximum time that is caught up after a pause [s]. */
const MAX_BACKLOG = 0.2;

/** Fraction of the golden ratio, whose multiples spread evenly. */
const SPREAD = 0.618034;

interface Group {
  readonly batch: Batch;
  /** States (count, S) one super step before those of the batch. */
  before: Float32Array;
  readonly first: number;
  step: number;
  waited: number;
}

export class Crowd {
  /** Work of the emulator and of passing on states, averaged over the last images [ms per image]. */
  workPerImage = 0;
  readonly #groups: Group[] = [];
  readonly #state: Float32Array;
  readonly #structure: StateStructure;

  constructor(
    emulator: Emulator,
    private readonly facts: Bundle,
    private readonly path: WanderPath,
    readonly count: number,
  ) {
    this.#state = new Float32Array(facts.rest.length);
    this.#structure = { rates: facts.rates, orientations: facts.orientations };
    const groups = Math.ceil(count / GROUP);
    for (let first = 0; first < count; first += GROUP) {
      const batch = emulator.batch(Math.min(GROUP, count - first));
      this.#groups.push(this.#makeGroup(batch, first, first / GROUP / groups));
    }
  }

  /** Advance by `seconds`, and pass each body's state (S) to `show`. */
  advance(seconds: number, show: (number: number, state: Float32Array) => void): void {
    const began = performance.now();
    for (const group of this.#groups) {
      group.waited += Math.min(seconds, MAX_BACKLOG);
      while (group.waited >= this.facts.dt) {
        group.waited -= this.facts.dt;
        this.#superStep(group);
      }
    }
    this.show(show);
    this.workPerImage += 0.05 * (performance.now() - began - this.workPerImage);
  }

  /** Pass each body's state (S), between its super steps, to `show`. */
  show(show: (number: number, state: Float32Array) => void): void {
    const { dt } = this.facts;
    const size = this.#state.length;
    for (const { batch, before, first, waited } of this.#groups) {
      const after = batch.states;
      for (let body = 0; body < batch.count; body++) {
        const [start, end] = [body * size, (body + 1) * size];
        interpolateHermite(before.subarray(start, end), after.subarray(start, end), waited / dt, dt, this.#structure, this.#state);
        show(first + body, this.#state);
      }
    }
  }

  /** Give every body this value of a parameter, by its state entry. */
  keep(entry: number, value: number): void {
    const size = this.#state.length;
    for (const { batch } of this.#groups) {
      const { states } = batch;
      for (let body = 0; body < batch.count; body++) {
        states[body * size + entry] = value;
      }
      batch.encode();
    }
  }

  #makeGroup(batch: Batch, first: number, share: number): Group {
    const size = this.#state.length;
    for (let body = 0; body < batch.count; body++) {
      batch.states.set(this.path.state(this.#phase(first + body)), body * size);
    }
    batch.encode();
    return { batch, before: batch.states.slice(), first, step: 0, waited: share * this.facts.dt };
  }

  #superStep(group: Group): void {
    const { batch, first } = group;
    const size = this.facts.control_low.length;
    group.before = batch.states.slice();
    for (let body = 0; body < batch.count; body++) {
      batch.controls.set(this.path.control(this.#phase(first + body) + group.step), body * size);
    }
    batch.advance();
    group.step += 1;
  }

  /** Super step of the path at which a body begins. */
  #phase(body: number): number {
    return Math.floor(((SPREAD * (body + 1)) % 1) * this.path.steps);
  }
}
