// Plays a motion and, at its end, lets the emulator go on live: one clock for everything that moves.

import type { Bundle, Push } from "../bundle/bundle";
import type { Emulator } from "../emulator/emulator";
import type { StateStructure } from "./interpolate";
import { Motion } from "./motion";

/** Maximum time that is caught up after a pause [s]. */
const MAX_BACKLOG = 0.25;

/** Number of motions that `undo` can bring back. */
const MAX_UNDO = 20;

/** Maximum length of a live motion, which is then cut at its start [s]: it must not fill the memory. */
export const MAX_SECONDS = 600;

/** Source of controls while the emulator runs live. */
export interface Pilot {
  /** Return the control (C) to hold from super step `step` on, in which the body is in `state`. */
  control(state: Float32Array, step: number): ArrayLike<number>;
  /** Return a state (S) with its commands in it: only for a body whose commands are in its state. */
  told?(state: Float32Array): Float32Array;
  /** Return the state (S) to go on from instead of the emulator's `next`, of which it is sure by `score`; null to follow the emulator. */
  instead?(state: Float32Array, next: Float32Array, score: number): Float32Array | null;
}

export type PlayerEvent = "motion" | "lost";

export class Player {
  motion: Motion;
  /** Position of the playhead [s]. */
  time = 0;
  /** Playback speed: 1 is real time. */
  speed = 1;
  isPlaying = false;
  /** Whether the emulator goes on where the motion ends; else the motion stops there, and the default motion restarts. */
  isLive = false;
  /** Whether the emulator goes on live where the default motion ends, instead of restarting it. */
  goesOn = false;
  /** Whether more of the motion will come from elsewhere, so that the playhead waits at its end. */
  isHeld = false;
  /** Pilot while the emulator runs live. */
  pilot: Pilot | null = null;
  /** Returns the change of a state (S) before the emulator leaps from it: a pull at the body. */
  force: ((state: Float32Array) => Float32Array) | null = null;
  /** Whether the latest state is of a recording on the physics, where the emulator knows nothing. */
  isRecorded = false;
  /** The emulator's work, averaged over the last images [ms per image]. */
  workPerImage = 0;
  /** Called with each event. */
  onEvent: (event: PlayerEvent) => void = () => undefined;

  readonly #structure: StateStructure;
  readonly #state: Float32Array;
  readonly #default: Motion;
  readonly #past: { motion: Motion; isLive: boolean; time: number }[] = [];

  constructor(
    readonly emulator: Emulator,
    readonly facts: Bundle,
  ) {
    this.#structure = { rates: facts.rates, orientations: facts.orientations };
    this.#state = new Float32Array(facts.rest.length);
    const { start, controls, pushes } = facts.default_motion;
    this.#default = this.motionFrom(start, controls.flat(), pushes);
    this.motion = this.#default;
  }

  /** Return the motion from a state (S) under controls (T * C), by the emulator, with `pushes` in between. */
  motionFrom(start: ArrayLike<number>, controls: ArrayLike<number>, pushes: readonly Push[] = []): Motion {
    const controlSize = this.emulator.sizes.control;
    const stateSize = this.emulator.sizes.state;
    const motion = new Motion(this.facts.dt, stateSize, controlSize, this.#structure, start);
    const flat = Float32Array.from(controls);
    const changes = new Map(pushes);
    const states = pushes.length === 0 ? this.emulator.rollout(start, flat) : null;
    for (let step = 0; step < flat.length / controlSize; step++) {
      const control = flat.subarray(step * controlSize, (step + 1) * controlSize);
      const change = changes.get(step);
      if (change) {
        motion.pushLast(change);
      }
      const { next, score } = this.emulator.stepTrusted(motion.state(step), control);
      motion.append(control, states?.subarray((step + 1) * stateSize, (step + 2) * stateSize) ?? next, score);
    }
    return motion;
  }

  /** Show another motion from its start. */
  show(motion: Motion, isLive = false): void {
    this.#remember();
    this.motion = motion;
    this.isLive = isLive;
    this.time = 0;
    this.onEvent("motion");
  }

  /** Show the system's default motion. */
  showDefault(): void {
    this.show(this.#default);
  }

  /** Bring back the motion shown before. */
  undo(): boolean {
    const past = this.#past.pop();
    if (!past) {
      return false;
    }
    this.motion = past.motion;
    this.isLive = past.isLive;
    this.time = Math.min(past.time, past.motion.duration);
    this.onEvent("motion");
    return true;
  }

  /** Go on live from the playhead: the rest is dropped, but `undo` brings it back. */
  goLive(): void {
    const steps = Math.min(Math.ceil(this.time / this.motion.dt), this.motion.steps);
    if (this.isLive && steps === this.motion.steps) {
      return;
    }
    this.#remember();
    this.motion = this.motion.upTo(steps);
    this.isLive = true;
    this.onEvent("motion");
  }

  /** Begin a live motion from a state (S). */
  restart(state: ArrayLike<number>): void {
    this.show(this.motionFrom(state, []), true);
  }

  /** Restart from the end of the motion, so that physics beside it starts there, too; `undo` brings the past back. */
  rebase(): void {
    const { motion } = this;
    this.#remember();
    this.motion = this.motionFrom(motion.state(motion.steps), []);
    this.time = Math.max(this.time - motion.duration, 0);
    this.onEvent("motion");
  }

  /** Move the playhead [s]. */
  seek(time: number): void {
    this.time = Math.min(Math.max(time, 0), this.motion.duration);
  }

  /** Move the playhead by whole super steps and stop there. */
  stepBy(steps: number): void {
    this.isPlaying = false;
    const position = Math.round(this.time / this.motion.dt) + steps;
    if (position > this.motion.steps && this.isLive) {
      this.#superStep();
    }
    this.seek(position * this.motion.dt);
  }

  /** Advance by `seconds` of real time. */
  advance(seconds: number): void {
    let worked = 0;
    if (this.isPlaying) {
      const share = Math.min(seconds, MAX_BACKLOG) * this.speed;
      this.time += share;
      const before = performance.now();
      while (this.isPlaying && this.isLive && this.time > this.motion.duration) {
        this.#superStep();
      }
      worked = performance.now() - before;
      if (!this.isLive && this.time > this.motion.duration) {
        this.#reachEnd();
      }
    }
    this.workPerImage += 0.05 * (worked - this.workPerImage);
  }

  /** Return the state (S) at the playhead, as a view that the next call changes. */
  state(): Float32Array {
    this.motion.sample(this.time, this.#state);
    return this.#state;
  }

  /** The super step in which the playhead stands. */
  get step(): number {
    return Math.max(0, Math.min(Math.floor(this.time / this.motion.dt), this.motion.steps - 1));
  }

  #superStep(): void {
    const { motion } = this;
    const state = motion.state(motion.steps);
    if (this.force) {
      motion.pushLast(this.force(state));
    }
    if (this.pilot?.told) {
      motion.setLast(this.pilot.told(state));
    }
    const control = this.pilot ? this.pilot.control(state, motion.steps) : this.#middle();
    const { next, score } = this.emulator.stepTrusted(state, control);
    const recorded = this.pilot?.instead?.(state, next, score) ?? null;
    this.isRecorded = recorded !== null;
    if (recorded) {
      motion.append(control, next.every(Number.isFinite) ? next : state, 0);
      motion.setLast(recorded);
    } else if (!next.every(Number.isFinite)) {
      this.isPlaying = false;
      this.time = motion.duration;
      this.onEvent("lost");
      return;
    } else {
      motion.append(control, next, score);
    }
    if (motion.duration > MAX_SECONDS) {
      this.rebase();
    }
  }

  #reachEnd(): void {
    const { duration } = this.motion;
    if (this.isHeld || this.motion !== this.#default) {
      this.time = duration;
      this.isPlaying &&= this.isHeld;
      return;
    }
    if (this.goesOn) {
      this.goLive();
      return;
    }
    this.time = duration > 0 ? this.time % duration : 0;
  }

  #middle(): number[] {
    return this.facts.control_low.map((low, i) => (low + this.facts.control_high[i]!) / 2);
  }

  #remember(): void {
    this.#past.push({ motion: this.motion, isLive: this.isLive, time: this.time });
    if (this.#past.length > MAX_UNDO) {
      this.#past.shift();
    }
  }
}
