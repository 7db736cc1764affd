// A target for a swimmer, moved by the mouse.

import type { Grabbable } from "../page/pointer";
import type { Session } from "../page/session";
import { makeTarget, type TargetHandle } from "../scene/handle";

/** Initial place of a target: ahead of the body and to its left, in its lengths. */
const AHEAD = 2.2;
const LEFT = 0.9;

export class SwimTarget implements Grabbable {
  #handle: TargetHandle | null = null;

  constructor(private readonly session: Session) {}

  get isShown(): boolean {
    return this.#handle !== null;
  }

  /** Show a target in front of the swimmer and swim to it. */
  show(): void {
    const { world, swimmer, player } = this.session;
    const handle = makeTarget(world.size);
    handle.moveTo(world.ahead(AHEAD, LEFT));
    world.add(handle.object);
    this.#handle = handle;
    swimmer!.target = handle.place;
    player.pilot = swimmer;
  }

  hide(): void {
    if (this.#handle) {
      this.session.world.remove(this.#handle.object);
      this.#handle.dispose();
      this.#handle = null;
      this.session.swimmer!.target = null;
    }
  }

  grab(x: number, y: number): boolean {
    return this.#handle !== null && this.session.world.isNear(x, y, this.#handle.place);
  }

  drag(x: number, y: number, isLevel: boolean): void {
    const place = this.session.world.dragPoint(x, y, this.#handle!.place, isLevel);
    if (place) {
      this.#handle!.moveTo(place);
    }
  }

  release(): void {
    // The target stays where it was released.
  }
}
