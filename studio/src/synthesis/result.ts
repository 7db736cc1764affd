// The result of a descent.

import type { Bundle } from "../bundle/bundle";
import { rootPose } from "../body/root";
import type { Emulator } from "../emulator/emulator";
import { Motion } from "../motion/motion";
import type { Values } from "./facts";
import type { EmulatedMotion } from "./module";

export interface Result {
  readonly number: number;
  readonly start: readonly number[];
  readonly values: Values;
  readonly cost: number;
  /** The motion by physics, or by the emulator if nothing is proved. */
  readonly motion: Motion;
  /** Positions of the body along it [m] ((T + 1) * 3); empty if nothing moves freely. */
  readonly path: readonly number[];
  /** Whether the physics has reached the goal; null if nothing is proved. */
  readonly isSuccess: boolean | null;
  /** The verdict in one line. */
  readonly verdict: string;
}

/** Return the motion of an iteration, for the player. */
export function motionOf(facts: Bundle, emulator: Emulator, { states, controls }: EmulatedMotion): Motion {
  return filled(facts, states, controls, "emulator", (state, control) => emulator.stepTrusted(state, control).score);
}

/** Return the motion by physics: `states` (T + 1, S) under `controls` (T, C). */
export function physicsMotion(facts: Bundle, states: Float32Array, controls: Float32Array): Motion {
  return filled(facts, states, controls, "physics", () => 0); // physics is true everywhere: no doubt
}

function filled(
  facts: Bundle,
  states: Float32Array,
  controls: Float32Array,
  source: Motion["source"],
  scoreOf: (state: Float32Array, control: Float32Array) => number,
): Motion {
  const [stateSize, controlSize] = [facts.rest.length, facts.control_low.length];
  const structure = { rates: facts.rates, orientations: facts.orientations };
  const motion = new Motion(facts.dt, stateSize, controlSize, structure, states.subarray(0, stateSize), source);
  for (let step = 0; step < controls.length / controlSize; step++) {
    const control = controls.subarray(step * controlSize, (step + 1) * controlSize);
    const next = states.subarray((step + 1) * stateSize, (step + 2) * stateSize);
    motion.append(control, next, scoreOf(motion.state(step), control));
  }
  return motion;
}

/** Return the positions of the whole body [m] (rows * 3) along `states` (rows * S); empty if nothing moves freely. */
export function pathOf(facts: Bundle, states: Float32Array): number[] {
  if (!facts.root) {
    return [];
  }
  const size = facts.rest.length;
  const points: number[] = [];
  for (let first = 0; first < states.length; first += size) {
    points.push(...rootPose(facts.root, states.subarray(first, first + size)).position);
  }
  return points;
}
