// Physics beside the emulator: the same controls on the true system, requested piece by piece.

import type { Bundle } from "../bundle/bundle";
import { Motion } from "../motion/motion";
import { lineOf } from "../page/banner";
import type { Physics } from "./physics";

/** Minimum number of new super steps in a request, unless the motion is finished. */
const PIECE = 4;

export class Twin {
  /** The motion by physics from the same start under the same controls; null before the first answer. */
  motion: Motion | null = null;
  /** Cost of physics by a user's scheme: seconds of work per second of motion; null before the first answer. */
  cost: number | null = null;
  isOn = false;
  onError: (line: string) => void = () => undefined;

  #of: Motion | null = null;
  #isAsking = false;

  constructor(
    private readonly physics: Physics,
    private readonly facts: Bundle,
  ) {}

  /** Follow `motion` as far as it goes; call once per image. `isGrowing` is whether more of it will come. */
  follow(motion: Motion, isGrowing: boolean): void {
    if (this.#of !== motion) {
      this.#of = motion;
      this.motion = null;
    }
    const done = this.motion?.steps ?? 0;
    const missing = motion.steps - done;
    if (!this.isOn || this.#isAsking || missing <= 0 || (isGrowing && missing < PIECE) || !this.physics.isReady) {
      return;
    }
    void this.#ask(motion, done);
  }

  async #ask(motion: Motion, done: number): Promise<void> {
    this.#isAsking = true;
    try {
      const start = this.motion ? this.motion.state(done) : motion.state(0);
      const controls = motion.controls(done);
      const count = controls.length / motion.controlSize;
      const pushes = motion.pushes(done, done + count);
      const replay = await this.physics.replay({ start, controls, pushes });
      if (this.#of === motion) {
        this.#append(motion, controls, replay.states);
        this.cost = replay.usualSeconds / (count * motion.dt);
      }
    } catch (error) {
      this.isOn = false;
      this.onError(lineOf(error));
    } finally {
      this.#isAsking = false;
    }
  }

  #append(of: Motion, controls: Float32Array, states: Float32Array): void {
    const { stateSize: size, controlSize } = of;
    const structure = { rates: this.facts.rates, orientations: this.facts.orientations };
    this.motion ??= new Motion(of.dt, size, controlSize, structure, states.subarray(0, size));
    for (let i = 0; i < controls.length / controlSize; i++) {
      const control = controls.subarray(i * controlSize, (i + 1) * controlSize);
      this.motion.append(control, states.subarray((i + 1) * size, (i + 2) * size), 0);
    }
  }
}
