// Another body of the family is grown along its own axes, and goes on from there.

import { expect, test } from "vitest";
import type { Bundle } from "../src/bundle/bundle";
import { GaitPilot } from "../src/steering/pilots";
import { reshape } from "../src/steering/reshape";

/** Two mass points, the nose first, their velocities, and their distance. */
const FAMILY = {
  dt: 0.1,
  control_low: [-1, 0],
  control_high: [1, 4],
  root: { kind: "points", position: [[0, 1]], velocity: [[6, 1]], forward: [[0, 1], [3, -1]], up: [[6, 1]] },
  parameters: [
    { name: "length", unit: "m", low: 1, high: 3, entry: 12, growth: [[0.5, 0, 0], [-0.5, 0, 0]] },
    { name: "stiffness", unit: "1", low: 0.5, high: 2, entry: 13, growth: [] },
  ],
} as unknown as Bundle;

test("a longer body is longer along itself, about the same middle", () => {
  // It points along Y; its up is read from the first velocity here.
  const state = new Float32Array([0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, 0, 2, 1]);
  const change = reshape(FAMILY, state, FAMILY.parameters![0]!, 3);
  const grown = state.map((number, i) => number + change[i]!);
  expect([...grown.subarray(0, 6)]).toEqual([0, 1.5, 0, 0, -1.5, 0]);
  expect(grown[12]).toBe(3);
  expect([...change.subarray(6, 12), change[13]]).toEqual([0, 0, 0, 0, 0, 0, 0]);
});

test("what shapes nothing changes itself alone", () => {
  const change = reshape(FAMILY, new Float32Array(14), FAMILY.parameters![1]!, 1.5);
  expect(change[13]).toBe(1.5);
  expect(Math.hypot(...change.subarray(0, 13))).toBe(0);
});

test("a body without a policy moves by its gait, about the control that is idle", () => {
  const pilot = new GaitPilot(FAMILY, { period: 0.4, amplitudes: [1, 0.5], lags: [0, Math.PI / 4] });
  const [first, second] = pilot.control(new Float32Array(14), 0);
  expect(first).toBeCloseTo(Math.sin(Math.PI / 4), 6);
  expect(second).toBeCloseTo(0, 6);
  const pulling = { period: 0.4, amplitudes: [0, 0.5], lags: [0, -Math.PI / 4] };
  expect(new GaitPilot(FAMILY, pulling).control(new Float32Array(14), 0)[1]).toBeCloseTo(2, 6);
  const resting = { ...pulling, amplitudes: [0, -0.5] };
  expect(new GaitPilot(FAMILY, resting).control(new Float32Array(14), 0)[1]).toBe(0);
});
