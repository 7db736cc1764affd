// A body pulled by the mouse: the held point follows the pointer, by a bounded push in every super step.

import type { Grabbable } from "../page/pointer";
import type { Session } from "../page/session";
import { makePathLine, TARGET_COLOUR, type PathLine } from "../scene/handle";
import type { Grip } from "../scene/world";
import { bounded, pullTo } from "./push";

/** Speed at which the held point follows the pointer, over their distance [1/s]. */
const EAGERNESS = 3;

/** Maximum distance that counts, over the body's size. */
const REACH = 0.5;

/** Maximum acceleration of the held point, over the body's size [1/s²]. */
const STRENGTH = 7;

export class BodyPull implements Grabbable {
  #grip: Grip | null = null;
  /** Position of the pointer [m], once it has moved. */
  #goal: [number, number, number] | null = null;
  #line: PathLine | null = null;

  constructor(
    private readonly session: Session,
    private readonly goLive: () => void,
  ) {}

  grab(x: number, y: number): boolean {
    this.#grip = this.session.world.pick(x, y);
    return this.#grip !== null;
  }

  drag(x: number, y: number): void {
    const { world, player } = this.session;
    const place = world.dragPoint(x, y, this.#grip!.point, false);
    if (!place) {
      return;
    }
    if (!this.#line) {
      this.#line = makePathLine(TARGET_COLOUR, 0.9, 2);
      world.add(this.#line.object);
      player.force = (state) => this.#pull(state);
    }
    this.#goal = place;
    // Physics that has taken over is pulled, too.
    if (!player.isLive && !player.isHeld) {
      this.goLive();
    }
    player.isPlaying = true;
  }

  /** Draw the spring. */
  update(): void {
    if (this.#line && this.#grip && this.#goal) {
      this.#line.show([...this.session.world.bonePoint(this.#grip.bone), ...this.#goal]);
    }
  }

  release(): void {
    const { world, player } = this.session;
    player.force = null;
    if (this.#line) {
      world.remove(this.#line.object);
      this.#line.dispose();
      this.#line = null;
    }
    this.#grip = null;
    this.#goal = null;
  }

  dispose(): void {
    this.release();
  }

  #pull(state: Float32Array): Float32Array {
    const { world, facts, walker } = this.session;
    const { bone } = this.#grip!;
    const point = world.bonePoint(bone);
    const offset = this.#goal!.map((value, axis) => value - point[axis]!);
    if (walker) {
      // Nobody lifts a walker off the ground.
      offset[2] = Math.min(offset[2]!, 0);
    }
    const wanted = bounded(offset, REACH * world.size).map((value) => EAGERNESS * value);
    return pullTo(facts, state, bone, wanted, STRENGTH * world.size * facts.dt);
  }
}
