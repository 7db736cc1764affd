// Where the emulator is lost, physics goes on: the same pilot on the true system, super step by super step.

import type { Bundle } from "../bundle/bundle";
import { Motion } from "../motion/motion";
import type { Player } from "../motion/player";
import { lineOf } from "../page/banner";
import type { Physics } from "./physics";

/** Physics goes so far ahead of the playhead [s]. */
const AHEAD = 0.4;

/** How often is looked whether there is more to do [ms]. */
const PAUSE = 20;

export class HandOver {
  #isOn = true;

  private constructor(
    private readonly physics: Physics,
    private readonly player: Player,
    /** What was shown before, and the super step at which physics took over. */
    private readonly before: Motion,
    private readonly step: number,
    /** Whether that was recorded: then its controls are known beyond there. */
    private readonly wasRecorded: boolean,
    private readonly motion: Motion,
  ) {}

  /** Let physics go on from where the playhead stands; `onError` is told one clear line if it cannot. */
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

  /** The state (S) in which it all began, if physics is what is shown; else null. */
  get origin(): Float32Array | null {
    return this.player.motion === this.motion ? this.before.state(0) : null;
  }

  stop(): void {
    this.#isOn = false;
    this.player.isHeld = false;
  }

  async #run(): Promise<void> {
    const { motion, player } = this;
    // Another motion on the stage means that nobody waits for this one.
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
      // Physics is true everywhere: nothing to doubt.
      motion.append(control, states.subarray(motion.stateSize, 2 * motion.stateSize), 0);
    }
    player.isHeld = false;
  }

  // Recorded controls as far as they go, then whoever steers.
  #control(state: Float32Array): number[] {
    const step = this.step + this.motion.steps;
    const isRecorded = this.wasRecorded && step < this.before.steps;
    return Array.from(isRecorded ? this.before.control(step) : this.player.pilot!.control(state, this.motion.steps));
  }

  // Without a single step of physics what was there before is better.
  #giveUp(): void {
    this.stop();
    if (this.motion.steps === 0 && this.player.motion === this.motion) {
      this.player.undo();
      this.player.isPlaying = false;
    }
  }
}
