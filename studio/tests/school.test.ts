// A school of the shipped fish, in Node as in the page: it swims, keeps level, keeps apart and stays in its water.

import { beforeAll, describe, expect, test } from "vitest";
import { rootPose, type RootPose } from "../src/body/root";
import { checkBundle, type Bundle } from "../src/bundle/bundle";
import { sizeOf } from "../src/bundle/layout";
import { Emulator } from "../src/emulator/emulator";
import { Policy } from "../src/emulator/policy";
import { School } from "../src/steering/school";
import { shippedFile } from "./shipped";

const LENGTH = 0.28;
const ROOM = { low: -1, high: 1 };

let facts: Bundle;
let emulator: Emulator;
let policy: Policy;

beforeAll(async () => {
  const text = new TextDecoder().decode(await shippedFile("fish-50/bundle.json"));
  facts = JSON.parse(text) as Bundle;
  checkBundle(facts);
  const sizes = { state: sizeOf(facts.state), control: sizeOf(facts.control), latent: facts.latent };
  const module = await WebAssembly.compile(await shippedFile("fish-50/emulator.wasm"));
  emulator = await Emulator.start(module, sizes);
  const policyModule = await WebAssembly.compile(await shippedFile("fish-50/policy.wasm"));
  policy = await Policy.start(policyModule, sizes.state, sizes.control);
});

function posesOf(school: School): RootPose[] {
  const size = facts.rest.length;
  return school.groups.flatMap((group) =>
    Array.from({ length: group.batch.count }, (_, body) =>
      rootPose(facts.root!, group.batch.states.slice(body * size, (body + 1) * size)),
    ),
  );
}

describe("a school of 60", () => {
  let before: RootPose[];
  let after: RootPose[];

  beforeAll(() => {
    const school = new School(emulator, policy, facts, LENGTH, ROOM, [0, 0, 0], 60);
    before = posesOf(school);
    for (let image = 0; image < 8 * 60; image++) {
      school.advance(1 / 60);
    }
    after = posesOf(school);
  });

  test("swims along", () => {
    const moved = after.map((pose, i) => Math.hypot(...pose.position.map((value, axis) => value - before[i]!.position[axis]!)));
    expect(Math.min(...moved)).toBeGreaterThan(0.2 * LENGTH);
  });

  test("keeps level and upright", () => {
    const pitches = after.map((pose) => Math.abs(Math.asin(pose.forward[2])));
    const rolls = after.map((pose) => Math.abs(pose.roll));
    expect(mean(pitches)).toBeLessThan(0.35);
    expect(mean(rolls)).toBeLessThan(0.35);
  });

  test("stays in its water", () => {
    for (const pose of after) {
      expect(pose.position[2]).toBeGreaterThan(ROOM.low);
      expect(pose.position[2]).toBeLessThan(ROOM.high);
    }
  });

  test("keeps apart: hardly anybody is where another is", () => {
    const nearest = after.map((pose, i) =>
      Math.min(
        ...after.map((other, j) =>
          i === j ? Infinity : Math.hypot(...pose.position.map((value, axis) => value - other.position[axis]!)),
        ),
      ),
    );
    const touching = nearest.filter((distance) => distance < 0.3 * LENGTH).length;
    expect(touching / nearest.length).toBeLessThan(0.1);
  });
});

test("a batch goes where single super steps go", () => {
  const control = facts.default_motion.controls[0]!;
  const batch = emulator.batch(3);
  batch.controls.set([...control, ...control, ...control]);
  batch.advance();
  const alone = emulator.step(facts.rest, control);
  const size = facts.rest.length;
  for (let body = 0; body < 3; body++) {
    batch.states.subarray(body * size, (body + 1) * size).forEach((value, i) => expect(value).toBeCloseTo(alone[i]!, 5));
  }
});

test("wrong sizes are refused by name", () => {
  expect(() => emulator.step([1, 2], facts.control_low)).toThrow(/state: wanted 150 numbers, got 2/);
});

function mean(numbers: number[]): number {
  return numbers.reduce((sum, value) => sum + value, 0) / numbers.length;
}
