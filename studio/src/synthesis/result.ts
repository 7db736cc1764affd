// What a descent came to.

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
  /** What the physics does, or the emulator where nothing is proved. */
  readonly motion: Motion;
  /** Where the body is along it [m] ((T + 1) * 3); empty where nothing moves freely. */
  readonly path: readonly number[];
  /** Whether the physics has done what was asked; null where nothing is proved. */
  readonly isSuccess: boolean | null;
  /** One line for people. */
  readonly verdict: string;
}

/** Return the motion of an iteration, as the player shows it. */
export function motionOf(facts: Bundle, emulator: Emulator, { states, controls }: EmulatedMotion): Motion {
  return filled(facts, states, controls, "emulator", (state, control) => emulator.stepTrusted(state, control).score);
}

/** Return what the physics did: `states` (T + 1, S) under `controls` (T, C). */
export function physicsMotion(facts: Bundle, states: Float32Array, controls: Float32Array): Motion {
  return filled(facts, states, controls, "physics", () => 0); // physics is true everywhere: nothing to doubt
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
