// A search ends as soon as the physics has done what was asked; until then it corrects the emulator by each replay.

import { readFileSync } from "node:fs";
import { expect, test } from "vitest";
import type { Bundle } from "../src/bundle/bundle";
import { PhysicsModule } from "../src/physics/module";
import { playPushed } from "../src/physics/page_physics";
import type { DescentFacts } from "../src/synthesis/facts";
import type { Court } from "../src/synthesis/proof";
import { MAX_CORRECTIONS, search, type Progress } from "../src/synthesis/search";
import { serve } from "../src/synthesis/serve";
import { Synthesiser } from "../src/synthesis/synthesiser";

const FISH = new URL("../neuroanimator_studio/bundles/fish-50/", import.meta.url);
const facts = JSON.parse(readFileSync(new URL("bundle.json", FISH), "utf8")) as Bundle;
const descent = facts.descents[0] as DescentFacts;

function compiled(name: string): Promise<WebAssembly.Module> {
  return WebAssembly.compile(readFileSync(new URL(name, FISH)));
}

/** A judge who asks for the place within `within` [m]. */
async function strict(within: number): Promise<Court> {
  const module = await PhysicsModule.start(await compiled("physics.wasm"), descent.state, descent.control);
  const physics: Court["physics"] = {
    isReady: true,
    replay: async (drive) => ({ ...(await playPushed(module, "rollout", drive)), usualSeconds: 0 }),
  };
  return { bundle: facts, descent: { ...descent, judged: { ...descent.judged!, within } }, physics, live: null };
}

/** Return all that a search yields. */
async function searched(court: Court | null): Promise<Progress[]> {
  const { port1, port2 } = new MessageChannel();
  serve(port2);
  const synthesiser = new Synthesiser(descent, await compiled(descent.wasm), port1);
  const steps: Progress[] = [];
  for await (const progress of search(synthesiser, court, { start: descent.start }, new AbortController().signal)) {
    steps.push(progress);
  }
  port1.close();
  return steps;
}

test("what the physics does at once is not corrected", async () => {
  const steps = await searched(await strict(descent.judged!.within));
  expect(steps.filter((one) => one.proof)).toHaveLength(1);
  expect(steps.at(-1)).toMatchObject({ corrections: 0, proof: { isSuccess: true } });
});

test("corrections bring the physics nearer, and end where that is enough", async () => {
  const gaps = (await searched(await strict(0))).flatMap(({ proof }) => (proof ? [proof.gap] : []));
  expect(gaps).toHaveLength(1 + MAX_CORRECTIONS);
  const least = Math.min(...gaps);
  expect(least).toBeLessThan(0.5 * gaps[0]!);
  const first = gaps.findIndex((gap) => gap <= least);
  const steps = await searched(await strict(1.001 * least));
  expect(steps.at(-1)).toMatchObject({ corrections: first, proof: { isSuccess: true } });
});

test("where no physics is at hand one descent is all, and proves nothing", async () => {
  const steps = await searched(null);
  expect(steps.every(({ corrections, proof }) => corrections === 0 && proof === null)).toBe(true);
  expect(steps.at(-1)!.iteration.isDone).toBe(true);
});
