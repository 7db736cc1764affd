// What a descent came to.

import type { Bundle } from "../bundle/bundle";
import { rootPose } from "../body/root";
import type { Emulator } from "../emulator/emulator";
import { Motion } from "../motion/motion";
import type { Iteration } from "./descend";
import type { Values } from "./facts";
import type { Proof } from "./proof";

export interface Result {
  readonly number: number;
  readonly start: readonly number[];
  readonly values: Values;
  readonly z: Float64Array;
  readonly iterations: number;
  readonly cost: number;
  readonly milliseconds: number;
  readonly motion: Motion;
  /** Where the body is along it [m] ((T + 1) * 3); empty where nothing moves freely. */
  readonly path: readonly number[];
  proof: Proof | null;
}

/** Return the motion of an iteration, as the player shows it. */
export function motionOf(facts: Bundle, emulator: Emulator, iteration: Iteration): Motion {
  const { state: stateSize, control: controlSize } = emulator.sizes;
  const structure = { rates: facts.rates, orientations: facts.orientations };
  const start = iteration.states.subarray(0, stateSize);
  const motion = new Motion(facts.dt, stateSize, controlSize, structure, start);
  for (let step = 0; step < iteration.controls.length / controlSize; step++) {
    const control = iteration.controls.subarray(step * controlSize, (step + 1) * controlSize);
    const next = iteration.states.subarray((step + 1) * stateSize, (step + 2) * stateSize);
    motion.append(control, next, emulator.stepTrusted(motion.state(step), control).score);
  }
  return motion;
}

/** Return where the whole body is [m] (rows * 3) along `states` (rows * S); nothing where nothing moves freely. */
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
