// The true physics of the body on show: by the server, or in the page if there is a module.

import type { LoadedBundle, Push } from "../bundle/bundle";
import type { Live } from "../server/live";
import { PagePhysics } from "./page_physics";
import { ServerPhysics } from "./server_physics";

/** Input of a replay, in the form of a Motion. */
export interface Drive {
  /** Initial state (S). */
  readonly start: ArrayLike<number>;
  /** Controls (T, C), one row after the other. */
  readonly controls: Float32Array;
  readonly pushes: readonly Push[];
}

/** Result of a replay. */
export interface Replay {
  /** States (T + 1, S), the start included. */
  readonly states: Float32Array;
  /** Time it took [s]. */
  readonly seconds: number;
  /** Time by a user's scheme [s], against which speed-ups are measured. */
  readonly usualSeconds: number;
}

export interface Physics {
  /** Whether it is available now. */
  readonly isReady: boolean;
  /** Return the motion by physics; the error is one clear line. */
  replay(drive: Drive): Promise<Replay>;
}

/** Return the physics of a bundle; null if there is none. The server is preferred: there, physics does not slow the page. */
export function physicsOf(bundle: LoadedBundle, live: Live | null): Physics | null {
  const { facts, folder } = bundle;
  if (live) {
    return facts.can_simulate === false ? null : new ServerPhysics(live, facts);
  }
  return facts.physics ? new PagePhysics(new URL(facts.physics, folder), facts) : null;
}
