// Steering by held keys: the commands of a swimmer or a walker, or the first controls of anything else.

import { labelsOf } from "../bundle/layout";
import type { Session } from "../page/session";
import type { MoverPilot } from "./movers";
import { clamp, type WalkPilot } from "./pilots";

/** Change of a swimmer's or walker's speed by keys, as a share of its fastest per second. */
const SPEED_CHANGE = 0.7;

/** Turn and climb by a held key [rad]. */
const TURN = 0.8;
const CLIMB = 0.5;

export class KeySteering {
  #wasSteering = false;

  constructor(private readonly held: ReadonlySet<string>) {}

  /** Whether keys are down. */
  get isSteering(): boolean {
    return this.held.size > 0;
  }

  /** Steer by the keys that are down; return whether this has just begun. */
  steer(session: Session, seconds: number): boolean {
    const { isSteering } = this;
    const hasBegun = isSteering && !this.#wasSteering;
    if (isSteering || this.#wasSteering) {
      const shares = [this.#axis("ArrowUp", "ArrowDown"), this.#axis("ArrowLeft", "ArrowRight"), this.#axis("PageUp", "PageDown")] as const;
      if (session.swimmer) {
        steerSwimmer(session, shares, seconds);
      } else if (session.walker) {
        steerWalker(session, session.walker, shares, seconds);
      } else if (session.movers) {
        steerMover(session, session.movers.pilot, isSteering ? shares : null);
      } else {
        steerControls(session, shares);
      }
    }
    this.#wasSteering = isSteering;
    return hasBegun;
  }

  #axis(more: string, less: string): number {
    return Number(this.held.has(more)) - Number(this.held.has(less));
  }
}

/** Return what the arrow keys and the page keys steer, in a few words each; null where they steer nothing. */
export function steeredBy({ swimmer, walker, movers, facts, sliders }: Session): readonly [arrows: string | null, pages: string | null] {
  if (swimmer) {
    return ["speed, turn", "climb"];
  }
  if (walker) {
    return ["speed, turn", null];
  }
  if (movers) {
    return ["away, aside", "height"];
  }
  const names = labelsOf(facts.control).slice(0, sliders.values.length).map((name) => name.replaceAll("_", " "));
  return [names.length > 0 ? names.slice(0, 2).join(", ") : null, names[2] ?? null];
}

type Shares = readonly [forward: number, left: number, up: number];

function steerSwimmer(session: Session, [forward, left, up]: Shares, seconds: number): void {
  const pilot = session.swimmer!;
  session.player.pilot = pilot;
  const faster = forward * SPEED_CHANGE * pilot.maxSpeed * seconds;
  pilot.command.speed = clamp(pilot.command.speed + faster, 0, pilot.maxSpeed);
  pilot.command.turn = TURN * left;
  pilot.command.climb = CLIMB * up;
}

function steerWalker(session: Session, pilot: WalkPilot, [forward, left]: Shares, seconds: number): void {
  session.player.pilot = pilot;
  const { low, high } = pilot.speeds;
  pilot.command.speed = clamp(pilot.command.speed + forward * SPEED_CHANGE * high * seconds, low, high);
  pilot.command.turning = left * (left > 0 ? pilot.turnings.high : -pilot.turnings.low);
}

// Relative to the camera: away from it, to its left, and up.
function steerMover(session: Session, pilot: MoverPilot, shares: Shares | null): void {
  session.player.pilot = pilot;
  if (!shares) {
    pilot.push(null);
    return;
  }
  const { ahead, left } = session.world.bearings;
  pilot.push([0, 1, 2].map((axis) => shares[0] * ahead[axis]! + shares[1] * left[axis]! + (axis === 2 ? shares[2] : 0)));
}

// Keys give all of a control or none of it.
function steerControls(session: Session, shares: Shares): void {
  const { sliders, facts } = session;
  session.player.pilot = sliders;
  shares.slice(0, sliders.values.length).forEach((share, i) => {
    const low = facts.control_low[i]!;
    const high = facts.control_high[i]!;
    const none = clamp(0, low, high);
    sliders.values[i] = share >= 0 ? none + share * (high - none) : none - share * (low - none);
  });
}
