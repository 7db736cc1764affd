// Descents in the page find what Python finds (vectors/write_descents.py), and are done by a service that can be stopped.

import { readFileSync } from "node:fs";
import { expect, test } from "vitest";
import { rootPose } from "../src/body/root";
import type { Bundle } from "../src/bundle/bundle";
import { descend, type Iteration } from "../src/synthesis/descend";
import type { DescentFacts, Values } from "../src/synthesis/facts";
import { DescentModule } from "../src/synthesis/module";
import { serve } from "../src/synthesis/serve";
import { solveDamped } from "../src/synthesis/solve";
import { Synthesiser, type WorkerPort } from "../src/synthesis/synthesiser";
import cases from "./vectors/descents.json";

const BUNDLES = new URL("../neuroanimator_studio/bundles/", import.meta.url);

/** J may be off by so much of itself: sums of float32 in orders of their own make other iterations after many. */
const EARLY = 0.03;
const LATE = 0.05;

/** Iterations after which J is compared as an early one. */
const FEW = 3;

/** More iterations than this, and rounding has the last word in which of several guesses ends best. */
const MANY = 15;

function factsOf(bundle: string): Bundle {
  return JSON.parse(readFileSync(new URL(`${bundle}/bundle.json`, BUNDLES), "utf8")) as Bundle;
}

function descentOf(bundle: string): DescentFacts {
  return factsOf(bundle).descents[0] as DescentFacts;
}

function compiled(bundle: string): Promise<WebAssembly.Module> {
  return WebAssembly.compile(readFileSync(new URL(`${bundle}/${descentOf(bundle).wasm}`, BUNDLES)));
}

async function opened(bundle: string): Promise<DescentModule> {
  return DescentModule.start(await compiled(bundle), descentOf(bundle));
}

test.each(cases.map((one, i) => ({ name: `${one.bundle} (${i})`, ...one })))("$name: J falls as it does in Python", async (one) => {
  const module = await opened(one.bundle);
  module.pose(module.facts.start, one.values as unknown as Values);
  const isLong = one.costs.length > MANY;
  const costs: number[] = [];
  for (const { iteration, cost } of descend(module)) {
    costs.push(cost);
    if (isLong && iteration === FEW) {
      break;
    }
  }
  for (let i = 0; i <= FEW; i++) {
    expect(Math.abs(costs[i]! / one.costs[i]! - 1)).toBeLessThan(EARLY);
  }
  if (!isLong) {
    expect(costs.length).toBe(one.costs.length);
    expect(Math.abs(costs.at(-1)! / one.costs.at(-1)! - 1)).toBeLessThan(LATE);
  }
});

test("a fish comes to where its target is dragged within 20 iterations", async () => {
  const module = await opened("fish-50");
  const { root, size } = factsOf("fish-50") as Bundle & { size: number };
  for (const place of [[0.2, 0.1, 0], [0.15, -0.12, 0.05], [0.3, 0, -0.05]]) {
    module.pose(module.facts.start, { place });
    const last = Array.from(descend(module)).at(-1)!;
    const { position } = rootPose(root!, last.states.subarray(-module.facts.state));
    expect(Math.hypot(...position.map((number, axis) => number - place[axis]!))).toBeLessThan(0.25 * size);
    expect(last.iteration).toBeLessThanOrEqual(20);
    expect(last.isDone).toBe(true);
  }
});

test("with the defects of a motion the emulator goes through it", async () => {
  const module = await opened("lander-50");
  module.pose(module.facts.start);
  const { controls, states } = module.motion(module.facts.guesses[0]!);
  // A wind that physics might have had.
  const blown = states.map((number, i) => number + (i % 13 === 0 ? 0.02 * Math.floor(i / 13) : 0));
  module.pose(module.facts.start, {}, module.defectsOf(blown, controls));
  const again = module.motion(module.facts.guesses[0]!).states;
  expect(Math.max(...again.map((number, i) => Math.abs(number - blown[i]!)))).toBeLessThan(1e-2);
  module.pose(module.facts.start);
  expect(module.motion(module.facts.guesses[0]!).states).toEqual(states);
});

test("numbers that do not fit are refused by name", async () => {
  const module = await opened("pendulum-50");
  expect(() => module.pose([0, 0])).toThrow("start: wanted 6 numbers, got 2");
  expect(() => module.pose(module.facts.start, { effort: [1, 2] })).toThrow("effort: wanted 1 numbers, got 2");
});

test("damped equations are solved, and those without a solution are known", () => {
  const solution = solveDamped([4, 9, 1, 2], 1, [10, 5]);
  expect(Array.from(solution!)).toEqual([expect.closeTo(25 / 14), expect.closeTo(15 / 14)]);
  expect(solveDamped([-1, 0, 0, 1], 0.5, [1, 1])).toBeNull();
});

async function served(bundle: string): Promise<{ synthesiser: Synthesiser; close: () => void }> {
  const { port1, port2 } = new MessageChannel();
  serve(port2);
  const synthesiser = new Synthesiser(descentOf(bundle), await compiled(bundle), port1);
  return { synthesiser, close: () => port1.close() };
}

test("a service yields every iteration, stops when it is told to, and goes on to the next descent", async () => {
  const { synthesiser, close } = await served("dolphin-50");
  const { start } = synthesiser.facts;
  const whole: Iteration[] = [];
  for await (const iteration of synthesiser.descend({ start })) {
    whole.push(iteration);
  }
  expect(whole.map((one) => one.iteration)).toEqual(whole.map((_, i) => i));
  expect(whole.at(-1)!.isDone).toBe(true);
  const stop = new AbortController();
  const some: number[] = [];
  for await (const iteration of synthesiser.descend({ start }, stop.signal)) {
    some.push(iteration.iteration);
    if (iteration.iteration === 2) {
      stop.abort();
    }
  }
  expect(some).toEqual([0, 1, 2]);
  for await (const iteration of synthesiser.descend({ start, guess: whole.at(-1)!.z })) {
    expect(iteration.cost).toBeLessThanOrEqual(whole.at(-1)!.cost * 1.001);
  }
  close();
});

test("what is wrong with a question comes back as one line", async () => {
  const { synthesiser, close } = await served("pendulum-50");
  await expect(synthesiser.descend({ start: [1] }).next()).rejects.toThrow("start: wanted 6 numbers, got 1");
  await expect(synthesiser.correct(new Float32Array(3), new Float32Array(3))).rejects.toThrow("states: wanted 246 numbers");
  close();
});

test("a worker that is stopped is said to be, and nobody waits for it", async () => {
  const deaf: WorkerPort = { postMessage: () => undefined, onmessage: null };
  const synthesiser = new Synthesiser(descentOf("pendulum-50"), await compiled("pendulum-50"), deaf);
  const first = synthesiser.descend({ start: synthesiser.facts.start }).next();
  (deaf.onerror as () => void)();
  await expect(first).rejects.toThrow("the optimising worker was stopped; reload the page");
});
