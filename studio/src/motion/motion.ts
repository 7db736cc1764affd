// A motion: states a super step apart, the controls between them, and the trust score of each step.

import type { Push } from "../bundle/bundle";
import { interpolateHermite, type StateStructure } from "./interpolate";

/** Initial capacity in super steps, doubled when it is full. */
const FIRST_ROOM = 256;

/** Score of the edge of training. */
export const EDGE = 1;

export class Motion {
  #states: Float32Array;
  #controls: Float32Array;
  #scores: Float32Array;
  #steps = 0;
  readonly #pushes = new Map<number, Float32Array>();

  constructor(
    readonly dt: number,
    readonly stateSize: number,
    readonly controlSize: number,
    private readonly structure: StateStructure,
    start: ArrayLike<number>,
    /** Its source. */
    readonly source: "emulator" | "physics" = "emulator",
  ) {
    this.#states = new Float32Array((FIRST_ROOM + 1) * stateSize);
    this.#controls = new Float32Array(FIRST_ROOM * controlSize);
    this.#scores = new Float32Array(FIRST_ROOM);
    this.#states.set(start, 0);
  }

  /** Number of super steps so far; there is one state more. */
  get steps(): number {
    return this.#steps;
  }

  /** Time of the last state [s]. */
  get duration(): number {
    return this.#steps * this.dt;
  }

  /** The state (S) after `step` super steps, as a view. */
  state(step: number): Float32Array {
    return this.#states.subarray(step * this.stateSize, (step + 1) * this.stateSize);
  }

  /** The control (C) of super step `step`, as a view. */
  control(step: number): Float32Array {
    return this.#controls.subarray(step * this.controlSize, (step + 1) * this.controlSize);
  }

  /** Distance of super step `step` from the training data: 1 is the edge. */
  score(step: number): number {
    return this.#scores[step]!;
  }

  /** Add `change` (S) to the last state, from which the motion goes on; before any step it changes the start. */
  pushLast(change: ArrayLike<number>): void {
    const state = this.state(this.#steps);
    for (let i = 0; i < state.length; i++) {
      state[i]! += change[i]!;
    }
    if (this.#steps > 0) {
      const known = this.#pushes.get(this.#steps);
      this.#pushes.set(this.#steps, Float32Array.from(change, (number, i) => number + (known?.[i] ?? 0)));
    }
  }

  /** Let the motion go on from `state` (S) instead of its last one, up to rounding. */
  setLast(state: ArrayLike<number>): void {
    this.pushLast(this.state(this.#steps).map((number, i) => state[i]! - number));
  }

  /** Changes added to states from super step `from` up to `to`, with their steps counted from `from`. */
  pushes(from = 0, to = this.#steps): Push[] {
    const within = [...this.#pushes].filter(([step]) => step >= from && step < to);
    return within.map(([step, change]) => [step - from, Array.from(change)]);
  }

  /** Append a super step: the control (C) held and the next state (S), with its score. */
  append(control: ArrayLike<number>, next: ArrayLike<number>, score: number): void {
    this.#makeRoom(this.#steps + 1);
    this.#controls.set(control, this.#steps * this.controlSize);
    this.#scores[this.#steps] = score;
    this.#steps += 1;
    this.#states.set(next, this.#steps * this.stateSize);
  }

  /** Return the first `steps` super steps of the motion. */
  upTo(steps: number): Motion {
    const motion = new Motion(this.dt, this.stateSize, this.controlSize, this.structure, this.state(0));
    for (let step = 0; step < Math.min(steps, this.#steps); step++) {
      motion.append(this.control(step), this.state(step + 1), this.score(step));
    }
    this.#pushes.forEach((change, step) => {
      if (step <= motion.steps) {
        motion.#pushes.set(step, change);
      }
    });
    return motion;
  }

  /** Return copies of all states (steps + 1, S). */
  states(): Float32Array {
    return this.#states.slice(0, (this.#steps + 1) * this.stateSize);
  }

  /** Return copies of the controls (steps, C) from super step `from` on. */
  controls(from = 0): Float32Array {
    return this.#controls.slice(from * this.controlSize, this.#steps * this.controlSize);
  }

  /** Write the state (S) at `time` [s] to `out`; the first before the start, the last after the end. */
  sample(time: number, out: Float32Array): void {
    const position = Math.min(Math.max(time / this.dt, 0), this.#steps);
    const step = Math.min(Math.floor(position), this.#steps - 1);
    if (step < 0) {
      out.set(this.state(0));
      return;
    }
    const share = position - step;
    interpolateHermite(this.state(step), this.state(step + 1), share, this.dt, this.structure, out);
  }

  #makeRoom(steps: number): void {
    if (steps <= this.#scores.length) {
      return;
    }
    const room = 2 * this.#scores.length;
    const states = new Float32Array((room + 1) * this.stateSize);
    const controls = new Float32Array(room * this.controlSize);
    const scores = new Float32Array(room);
    states.set(this.#states);
    controls.set(this.#controls);
    scores.set(this.#scores);
    this.#states = states;
    this.#controls = controls;
    this.#scores = scores;
  }
}
