// Physics beside the emulator: the same controls on the true system, asked for from the server piece by piece.

import { floatsOf } from "../bundle/base64";
import type { Bundle } from "../bundle/bundle";
import type { Motion } from "../motion/motion";
import { Motion as MotionRecord } from "../motion/motion";
import { lineOf } from "../page/banner";
import type { Live } from "./live";

/** At least so many new super steps are asked for at a time, unless the motion is finished. */
const PIECE = 4;

export class Twin {
  /** What physics did, from the same start under the same controls; null before the first answer. */
  motion: Motion | null = null;
  /** Physics' own speed, measured by the server: seconds of its work a second of motion; null before the first answer. */
  cost: number | null = null;
  isOn = false;
  onError: (line: string) => void = () => undefined;

  #of: Motion | null = null;
  #isAsking = false;

  constructor(
    private readonly live: Live,
    private readonly facts: Bundle,
  ) {}

  /** Follow `motion` as far as it goes; call once an image. `isGrowing` says whether more of it will come. */
  follow(motion: Motion, isGrowing: boolean): void {
    if (this.#of !== motion) {
      this.#of = motion;
      this.motion = null;
    }
    const done = this.motion?.steps ?? 0;
    const missing = motion.steps - done;
    if (!this.isOn || this.#isAsking || missing <= 0 || (isGrowing && missing < PIECE) || !this.live.isOpen) {
      return;
    }
    void this.#ask(motion, done);
  }

  async #ask(motion: Motion, done: number): Promise<void> {
    this.#isAsking = true;
    try {
      const start = this.motion ? this.motion.state(done) : motion.state(0);
      const controls: number[][] = [];
      for (let step = done; step < motion.steps; step++) {
        controls.push(Array.from(motion.control(step)));
      }
      const answer = await this.live.ask("replay", {
        bundle: this.facts.id,
        start: Array.from(start),
        controls,
        pushes: motion.pushes(done, done + controls.length),
      });
      if (this.#of === motion) {
        this.#append(motion, controls, floatsOf(String(answer["states"])));
        this.cost = Number(answer["usual_wall_s"] ?? answer["wall_s"]) / (controls.length * motion.dt);
      }
    } catch (error) {
      this.isOn = false;
      this.onError(lineOf(error));
    } finally {
      this.#isAsking = false;
    }
  }

  #append(of: Motion, controls: number[][], states: Float32Array): void {
    const size = of.stateSize;
    const structure = { rates: this.facts.rates, orientations: this.facts.orientations };
    this.motion ??= new MotionRecord(of.dt, size, of.controlSize, structure, states.subarray(0, size));
    controls.forEach((control, i) => {
      this.motion!.append(control, states.subarray((i + 1) * size, (i + 2) * size), 0);
    });
  }

  /** How far emulator and physics are apart at super step `step`: the mean distance of the bones [m] comes from the page. */
  reaches(step: number): boolean {
    return this.motion !== null && this.motion.steps >= step;
  }
}
