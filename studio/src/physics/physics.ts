// The true physics of the body on show: by the server, or in the page where its module is at hand.

import type { LoadedBundle, Push } from "../bundle/bundle";
import type { Live } from "../server/live";
import { PagePhysics } from "./page_physics";
import { ServerPhysics } from "./server_physics";

/** What physics is to do: as a Motion holds it. */
export interface Drive {
  /** (S) */
  readonly start: ArrayLike<number>;
  /** (T, C), one row after the other. */
  readonly controls: Float32Array;
  readonly pushes: readonly Push[];
}

/** What physics did. */
export interface Replay {
  /** (T + 1, S), the start included. */
  readonly states: Float32Array;
  /** Time it took [s]. */
  readonly seconds: number;
  /** Time it takes as a user would run it [s]: what speed-ups are measured against. */
  readonly usualSeconds: number;
}

export interface Physics {
  /** Whether it can be asked now. */
  readonly isReady: boolean;
  /** Return what physics does; the error is one clear line. */
  replay(drive: Drive): Promise<Replay>;
}

/** Return what replays the motions of a bundle; null where nothing does. The server goes first: there, physics slows no page. */
export function physicsOf(bundle: LoadedBundle, live: Live | null): Physics | null {
  const { facts, folder } = bundle;
  if (live) {
    return facts.can_simulate === false ? null : new ServerPhysics(live, facts);
  }
  return facts.physics ? new PagePhysics(new URL(facts.physics, folder), facts) : null;
}
