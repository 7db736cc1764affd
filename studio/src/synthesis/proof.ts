// The proof: the same controls on the true physics, and whether a person would call it success.

import { base64Of } from "../bundle/base64";
import type { Bundle } from "../bundle/bundle";
import type { Physics } from "../physics/physics";
import type { Live } from "../server/live";
import type { DescentFacts, Values } from "./facts";
import { judgeSwimming, type Verdict } from "./judge";
import type { EmulatedMotion } from "./module";

export interface Proof extends Verdict {
  /** States by physics (T + 1, S). */
  readonly states: Float32Array;
}

/** The parts needed for a proof. */
export interface Court {
  readonly bundle: Bundle;
  readonly descent: DescentFacts;
  readonly physics: Physics;
  /** Connection to the server, if there is one, which judges. */
  readonly live: Live | null;
}

/** Return whether a descent's motions can be judged. */
export function canJudge({ bundle, descent, live }: Omit<Court, "physics">): boolean {
  return live !== null || (descent.judged !== null && bundle.root !== null);
}

/** Replay the controls of an emulated motion on the physics and judge the result; the error is one clear line. */
export async function prove(court: Court, { states, controls }: EmulatedMotion, values: Values): Promise<Proof> {
  const start = states.subarray(0, court.descent.state);
  const replay = await court.physics.replay({ start, controls, pushes: [] });
  return { ...(await judge(court, values, replay.states)), states: replay.states };
}

async function judge({ bundle, descent, live }: Court, values: Values, states: Float32Array): Promise<Verdict> {
  if (live === null) {
    const place = values["place"] ?? descent.movable.find((movable) => movable.name === "place")!.value;
    return judgeSwimming(bundle.root!, descent.judged!, place, states, bundle.rest.length);
  }
  const verdict = await live.ask("judge_descent", { bundle: bundle.id, values, states: base64Of(states) });
  return { isSuccess: verdict["is_success"] === true, gap: Number(verdict["gap"]), words: String(verdict["words"]) };
}
