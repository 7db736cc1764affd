// Levenberg and Marquardt's method, as in `control/descent/methods.py`: several dampings are tried side by side.

import type { Settings } from "./facts";
import type { DescentModule, EmulatedMotion, QuadraticModel } from "./module";
import { solveDamped } from "./solve";

/** Number of iterations after each of which the worse half of all starts ends (successive halving). */
const ROUND = 4;

/** Number of starts that are never ended by it: the best of few is not known early. */
const FEW_STARTS = 4;

/** Progress of a descent. */
export interface Iteration extends EmulatedMotion {
  /** 0 is the first guess. */
  readonly iteration: number;
  /** Smallest J so far. */
  readonly cost: number;
  /** Variables (Z); a later descent may begin with them. */
  readonly z: Float64Array;
  readonly isDone: boolean;
  /** Time so far [ms]. */
  readonly milliseconds: number;
}

/** Progress from one initial guess. */
interface Start {
  z: Float64Array;
  least: number;
  damping: number;
  sweeps: number;
  isDone: boolean;
}

/** Yield every iteration of a descent from `guesses`, each (Z), the initial one included; the best of them is shown. */
export function* descend(
  module: DescentModule,
  guesses: readonly ArrayLike<number>[] = module.facts.guesses,
): Generator<Iteration, void> {
  const { settings } = module.facts;
  let worked = 0;
  let since = performance.now();
  const shown = (iteration: number): Iteration => {
    const best = starts.reduce((one, other) => (other.least < one.least ? other : one));
    const motion = module.motion(best.z);
    const isDone = starts.every((start) => start.isDone);
    worked += performance.now() - since;
    return { iteration, cost: best.least, z: best.z, isDone, milliseconds: worked, ...motion };
  };
  const costs = module.costs(guesses);
  const starts = guesses.map(
    (guess, i): Start => ({
      z: Float64Array.from(guess),
      least: finiteOr(costs[i]!),
      damping: settings.first_damping,
      sweeps: 0,
      isDone: false,
    }),
  );
  yield shown(0);
  for (let iteration = 1; starts.some((start) => !start.isDone); iteration++) {
    // The caller's work in between does not count.
    since = performance.now();
    for (const start of starts) {
      if (!start.isDone) {
        iterate(module, start, settings);
        start.isDone ||= start.sweeps >= settings.iterations;
      }
    }
    if (iteration % ROUND === 0) {
      halve(starts);
    }
    yield shown(iteration);
  }
}

/** End the worse half of the remaining starts. */
function halve(starts: readonly Start[]): void {
  const going = starts.filter((start) => !start.isDone).sort((one, other) => one.least - other.least);
  going.slice(Math.max(FEW_STARTS, Math.ceil(going.length / 2))).forEach((start) => (start.isDone = true));
}

/** Take `start` one iteration further. */
function iterate(module: DescentModule, start: Start, settings: Settings): void {
  const model = module.quadraticModel(start.z);
  const isFirst = start.sweeps === 0;
  start.sweeps += 1;
  if (isFirst) {
    start.least = finiteOr(model.cost);
  }
  if (!model.slope.every(Number.isFinite)) {
    start.isDone = true;
    return;
  }
  const dampings = settings.dampings.map((times) =>
    Math.min(Math.max(times * start.damping, settings.min_damping), settings.max_damping),
  );
  const trials = dampings.map((damping) => stepped(start.z, model, damping));
  const costs = module.costs(trials).map(finiteOr);
  const cost = Math.min(...costs);
  const best = costs.indexOf(cost);
  const largest = dampings.at(-1)!;
  if (!(cost < start.least)) {
    start.isDone = largest >= settings.max_damping;
    start.damping = largest * settings.dampings.at(-1)!;
    return;
  }
  // The first step finds the damping's scale; after it, small decreases end the descent.
  start.isDone = !isFirst && start.least - cost < settings.converged * start.least;
  start.z = trials[best]!;
  start.least = cost;
  start.damping = dampings[best]!;
}

/** Return z - (curvature + damping · its mean diagonal)⁻¹ slope; NaN if there is no inverse. */
function stepped(z: Float64Array, model: QuadraticModel, damping: number): Float64Array {
  let trace = 0;
  for (let i = 0; i < z.length; i++) {
    trace += model.curvature[i * z.length + i]!;
  }
  const added = damping * (trace / z.length + Number.MIN_VALUE);
  const step = solveDamped(model.curvature, added, model.slope);
  return z.map((number, i) => number - (step === null ? NaN : step[i]!));
}

function finiteOr(number: number): number {
  return Number.isFinite(number) ? number : Infinity;
}
