// Where the emulator is lost, physics goes on: the same pilot on the true system, super step by super step.

import { floatsOf } from "../bundle/base64";
import type { Bundle } from "../bundle/bundle";
import { Motion } from "../motion/motion";
import type { Player } from "../motion/player";
import { lineOf } from "../page/banner";
import type { Live } from "./live";

/** Physics goes so far ahead of the playhead [s]. */
const AHEAD = 0.4;

/** How often is looked whether there is more to do [ms]. */
const PAUSE = 20;

export class HandOver {
  #isOn = true;

  private constructor(
    private readonly live: Live,
    private readonly facts: Bundle,
    private readonly player: Player,
    private readonly motion: Motion,
  ) {}

  /** Let physics go on from `state` (S); `onError` is told one clear line if it cannot. */
  static begin(
    live: Live,
    facts: Bundle,
    player: Player,
    state: ArrayLike<number>,
    onError: (line: string) => void,
  ): HandOver {
    const structure = { rates: facts.rates, orientations: facts.orientations };
    const motion = new Motion(facts.dt, facts.rest.length, facts.control_low.length, structure, state);
    player.show(motion);
    player.isHeld = true;
    player.isPlaying = true;
    const handOver = new HandOver(live, facts, player, motion);
    handOver.#run().catch((error: unknown) => onError(lineOf(error)));
    return handOver;
  }

  stop(): void {
    this.#isOn = false;
    this.player.isHeld = false;
  }

  async #run(): Promise<void> {
    const { motion, player, facts } = this;
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
      const control = Array.from(player.pilot!.control(state, motion.steps));
      const answer = await this.live.ask("replay", { bundle: facts.id, start: Array.from(state), controls: [control] });
      const states = floatsOf(String(answer["states"]));
      // Physics is true everywhere: nothing to doubt.
      motion.append(control, states.subarray(motion.stateSize, 2 * motion.stateSize), true);
    }
    player.isHeld = false;
  }
}
