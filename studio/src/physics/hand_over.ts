// Where the emulator is lost, physics goes on: the same pilot on the true system, super step by super step.

import type { Bundle } from "../bundle/bundle";
import { Motion } from "../motion/motion";
import type { Player } from "../motion/player";
import { lineOf } from "../page/banner";
import type { Physics } from "./physics";

/** Time by which physics is ahead of the playhead [s]. */
const AHEAD = 0.4;

/** Interval between checks for more work [ms]. */
const PAUSE = 20;

export class HandOver {
  #isOn = true;

  private constructor(
    private readonly physics: Physics,
    private readonly player: Player,
    /** The motion shown before, and the super step at which physics took over. */
    private readonly before: Motion,
    private readonly step: number,
    /** Whether that was recorded, so that its controls are known beyond that step. */
    private readonly wasRecorded: boolean,
    private readonly motion: Motion,
  ) {}

  /** Continue with physics from the playhead; `onError` is called with one clear line if it cannot. */
  static begin(physics: Physics, facts: Bundle, player: Player, onError: (line: string) => void): HandOver {
    const structure = { rates: facts.rates, orientations: facts.orientations };
    const before = player.motion;
    const { step } = player;
    const wasRecorded = !player.isLive;
    const motion = new Motion(facts.dt, facts.rest.length, facts.control_low.length, structure, before.state(step), "physics");
    player.show(motion);
    player.isHeld = true;
    player.isPlaying = true;
    const handOver = new HandOver(physics, player, before, step, wasRecorded, motion);
    handOver.#run().catch((error: unknown) => {
      handOver.#giveUp();
      onError(lineOf(error));
    });
    return handOver;
  }

  /** The initial state (S), if physics is shown; else null. */
  get origin(): Float32Array | null {
    return this.player.motion === this.motion ? this.before.state(0) : null;
  }

  stop(): void {
    this.#isOn = false;
    this.player.isHeld = false;
  }

  async #run(): Promise<void> {
    const { motion, player } = this;
    // If another motion is on the stage, nobody waits for this one.
    while (this.#isOn && player.motion === motion) {
      if (motion.duration - player.time > AHEAD) {
        await new Promise((resolve) => setTimeout(resolve, PAUSE));
        continue;
      }
      if (player.force) {
        motion.pushLast(player.force(motion.state(motion.steps)));
      }
      const state = motion.state(motion.steps);
      const control = this.#control(state);
      const { states } = await this.physics.replay({ start: state, controls: Float32Array.from(control), pushes: [] });
      // Physics is true everywhere: no doubt.
      motion.append(control, states.subarray(motion.stateSize, 2 * motion.stateSize), 0);
    }
    player.isHeld = false;
  }

  // Recorded controls as far as they go, then the pilot.
  #control(state: Float32Array): number[] {
    const step = this.step + this.motion.steps;
    const isRecorded = this.wasRecorded && step < this.before.steps;
    return Array.from(isRecorded ? this.before.control(step) : this.player.pilot!.control(state, this.motion.steps));
  }

  // Without a single step of physics, the motion before is better.
  #giveUp(): void {
    this.stop();
    if (this.motion.steps === 0 && this.player.motion === this.motion) {
      this.player.undo();
      this.player.isPlaying = false;
    }
  }
}
