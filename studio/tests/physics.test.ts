// Physics in the page is one motion however it is cut, and its swims are judged as Python judges them.

import { readFile } from "node:fs/promises";
import { beforeAll, expect, test } from "vitest";
import type { Bundle } from "../src/bundle/bundle";
import { sizeOf } from "../src/bundle/layout";
import { PhysicsModule } from "../src/physics/module";
import { playPushed } from "../src/physics/page_physics";
import type { Judged } from "../src/synthesis/facts";
import { judgeSwimming } from "../src/synthesis/judge";
import { shippedFile } from "./shipped";

interface Case {
  readonly bundle: string;
  readonly start: readonly number[];
  readonly controls: readonly (readonly number[])[];
  readonly place: readonly number[];
  readonly is_success: boolean;
  readonly words: string;
}

const cases: Case[] = JSON.parse(await readFile(new URL("vectors/verdicts.json", import.meta.url), "utf-8"));

async function opened(bundle: string): Promise<{ facts: Bundle; module: PhysicsModule }> {
  const facts = JSON.parse(new TextDecoder().decode(await shippedFile(`${bundle}/bundle.json`))) as Bundle;
  const module = await WebAssembly.compile(await shippedFile(`${bundle}/physics.wasm`));
  return { facts, module: await PhysicsModule.start(module, sizeOf(facts.state), sizeOf(facts.control)) };
}

let fish: { facts: Bundle; module: PhysicsModule };

beforeAll(async () => {
  fish = await opened("fish-50");
});

test.each(cases.map((one, number) => [`${one.bundle}, case ${number}`, one] as const))("%s is judged as in Python", async (_, one) => {
  const { facts, module } = await opened(one.bundle);
  const { judged } = facts.descents[0] as { judged: Judged };
  const drive = { start: one.start, controls: Float32Array.from(one.controls.flat()), pushes: [] };
  const { states } = await playPushed(module, "rollout", drive);
  const verdict = judgeSwimming(facts.root!, judged, one.place, states, module.stateSize);
  expect([verdict.isSuccess, verdict.words]).toEqual([one.is_success, one.words]);
});

test("a push is felt from its super step on, as if the motion began there", async () => {
  const { module } = fish;
  const { start, controls: rows } = cases[0]!;
  const controls = Float32Array.from(rows.flat());
  const change = start.map((_, i) => (i >= start.length / 2 && i % 3 === 1 ? 0.2 : 0));
  const { states } = await playPushed(module, "rollout", { start, controls, pushes: [[7, change]] });
  const size = module.stateSize;
  const before = module.play("rollout", start, controls.subarray(0, 7 * module.controlSize));
  const pushed = before.slice(-size).map((number, i) => number + change[i]!);
  const after = module.play("rollout", pushed, controls.subarray(7 * module.controlSize));
  const apart = (one: Float32Array, other: Float32Array): number => Math.max(...one.map((number, i) => Math.abs(number - other[i]!)));
  expect(apart(states.subarray(size, 8 * size), before)).toBeLessThan(1e-5);
  expect(apart(states.subarray(8 * size), after)).toBeLessThan(1e-5);
});
