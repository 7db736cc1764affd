// The true physics in the page, if there is a module of the body's physics.

import type { Bundle, Push } from "../bundle/bundle";
import { fetchModule } from "../emulator/instance";
import { PhysicsModule, type Way } from "./module";
import type { Drive, Physics, Replay } from "./physics";

/** Time it works before the page has its turn [ms]. */
const TURN = 8;

/** Number of super steps between looks at the clock. */
const PIECE = 4;

/** The states (T + 1, S), the start included, and the time they took [s]. */
interface Played {
  readonly states: Float32Array;
  readonly seconds: number;
}

export class PagePhysics implements Physics {
  readonly isReady = true;
  #module: Promise<PhysicsModule> | null = null;

  /** `address` is that of the module of the bundle with `facts`, fetched when physics is first used. */
  constructor(
    private readonly address: URL,
    private readonly facts: Bundle,
  ) {}

  async replay(drive: Drive): Promise<Replay> {
    const module = await (this.#module ??= this.#open());
    const { states, seconds } = await playPushed(module, "rollout", drive);
    if (!states.every(Number.isFinite)) {
      throw new Error("the physics diverged under these controls; shorten the motion, or make it milder");
    }
    // The user's scheme is only run to measure its time.
    const usual = await playPushed(module, "rollout_usual", drive);
    return { states, seconds, usualSeconds: usual.seconds };
  }

  async #open(): Promise<PhysicsModule> {
    try {
      const { rest, control_low: low } = this.facts;
      return await PhysicsModule.start(await fetchModule(this.address), rest.length, low.length);
    } catch (error) {
      this.#module = null;
      throw error;
    }
  }
}

/** Play a drive with its pushes. */
export async function playPushed(module: PhysicsModule, way: Way, { start, controls, pushes }: Drive): Promise<Played> {
  const { stateSize, controlSize } = module;
  const steps = controls.length / controlSize;
  const states = new Float32Array((steps + 1) * stateSize);
  states.set(start);
  const state = Float32Array.from(start);
  let milliseconds = 0;
  let turn = 0;
  let done = 0;
  while (done < steps) {
    pushes.filter(([step]) => step === done).forEach(([, change]) => change.forEach((number, i) => (state[i]! += number)));
    const end = Math.min(done + PIECE, nextPush(pushes, done), steps);
    const began = performance.now();
    const made = module.play(way, state, controls.subarray(done * controlSize, end * controlSize));
    const took = performance.now() - began;
    states.set(made, (done + 1) * stateSize);
    state.set(made.subarray(made.length - stateSize));
    milliseconds += took;
    turn += took;
    if (turn > TURN) {
      await new Promise((resume) => setTimeout(resume));
      turn = 0;
    }
    done = end;
  }
  return { states, seconds: milliseconds / 1000 };
}

/** Return the first super step after `done` before which there is a push. */
function nextPush(pushes: readonly Push[], done: number): number {
  return Math.min(...pushes.map(([step]) => step).filter((step) => step > done), Infinity);
}
