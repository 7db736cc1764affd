// The proof: the same controls on the true physics, by the server, and whether a person would call it success.

import { floatsOf } from "../bundle/base64";
import type { Live } from "../server/live";
import type { Values } from "./facts";
import type { Result } from "./result";

export interface Proof {
  /** (T + 1, S) what physics did. */
  readonly states: Float32Array;
  readonly isSuccess: boolean;
  /** How far off it ended. */
  readonly gap: number;
  readonly words: string;
  /** Time the physics took [s]. */
  readonly seconds: number;
}

/** Ask the server what the controls of `result` do; the error is one clear line. */
export async function prove(live: Live, bundle: string, result: Result): Promise<Proof> {
  const { motion, values } = result;
  const controls = Array.from({ length: motion.steps }, (_, step) => Array.from(motion.control(step)));
  const replay = await live.ask("replay", { bundle, start: Array.from(motion.state(0)), controls });
  const packed = String(replay["states"]);
  const verdict = await live.ask("judge_descent", { bundle, values: values as Record<string, Values[string]>, states: packed });
  return {
    states: floatsOf(packed),
    isSuccess: verdict["is_success"] === true,
    gap: Number(verdict["gap"]),
    words: String(verdict["words"]),
    seconds: Number(replay["wall_s"]),
  };
}
