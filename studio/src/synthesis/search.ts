// From a goal to controls proved on the physics, as in `control/synthesis`: descend, replay, correct, descend again.

import type { Iteration } from "./descend";
import { prove, type Court, type Proof } from "./proof";
import type { Wanted } from "./serve";
import type { Synthesiser } from "./synthesiser";

/** Maximum number of replays whose defects are added to the emulator. */
export const MAX_CORRECTIONS = 5;

/** Progress of a search. */
export interface Progress {
  /** Number of corrections before this descent. */
  readonly corrections: number;
  readonly iteration: Iteration;
  /** Its proof on the physics; null before the descent is done, and if nothing is proved. */
  readonly proof: Proof | null;
}

/** Yield every iteration of every descent, and each last one again with its proof; without a `court` there is one descent. */
export async function* search(
  synthesiser: Synthesiser,
  court: Court | null,
  wanted: Wanted,
  signal: AbortSignal,
): AsyncGenerator<Progress, void> {
  let corrected = wanted;
  for (let corrections = 0; ; corrections++) {
    let last: Iteration | null = null;
    for await (const iteration of synthesiser.descend(corrected, signal)) {
      last = iteration;
      yield { corrections, iteration, proof: null };
    }
    if (!court || !last || signal.aborted) {
      return;
    }
    const proof = await prove(court, last, wanted.values ?? {});
    yield { corrections, iteration: last, proof };
    if (proof.isSuccess || corrections === MAX_CORRECTIONS || signal.aborted) {
      return;
    }
    const defects = await synthesiser.correct(proof.states, last.controls);
    corrected = { ...wanted, guess: last.z, defects };
  }
}
