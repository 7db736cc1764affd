// A hand that drops food where the water is clicked, for the small fish that live around a body.

import type { Grabbable } from "../page/pointer";
import type { Session } from "../page/session";

export class FeedingHand implements Grabbable {
  constructor(private readonly session: Session) {}

  grab(): boolean {
    return false;
  }

  drag(): void {
    // It holds nothing.
  }

  release(): void {
    // It holds nothing.
  }

  tap(x: number, y: number): void {
    const { life, world } = this.session;
    const place = life && world.dragPoint(x, y, world.middle, false);
    if (place) {
      place[2] = Math.max(place[2], world.room.low + 0.1 * world.size);
      life.feed(place);
    }
  }
}
