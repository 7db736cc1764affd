// A push gives the point that is held the velocity that is asked for, and disturbs little else.

import { expect, test } from "vitest";
import type { Bundle } from "../src/bundle/bundle";
import { push } from "../src/steering/push";

/** One free body: position, quaternion, velocity, angular velocity. */
const FREE = {
  rates: [[0, 7], [1, 8], [2, 9]],
  orientations: [[3, 10]],
  skeleton: [
    {
      name: "body",
      parent: -1,
      offset: [0, 0, 0],
      orientation: [1, 0, 0, 0],
      joints: [{ kind: "free", entry: 0, axis: [0, 0, 1], anchor: [0, 0, 0], reference: 0 }],
      shapes: [],
    },
  ],
} as unknown as Bundle;

test("a push at the middle moves a free body without turning it", () => {
  const state = new Float32Array([1, 2, 3, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
  const gained = push(FREE, state, 0, [0, 0, 0], [0.5, 0, -0.2]);
  expect(gained[7]).toBeCloseTo(0.5, 2);
  expect(gained[9]).toBeCloseTo(-0.2, 2);
  expect(Math.hypot(gained[10]!, gained[11]!, gained[12]!)).toBeLessThan(1e-6);
  expect(Math.hypot(...gained.subarray(0, 7))).toBe(0);
});

test("a push beside the middle gives that point its velocity, and turns the body", () => {
  const state = new Float32Array([0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
  const gained = push(FREE, state, 0, [1, 0, 0], [0, 0, 1]);
  // v + ω × r at r = (1, 0, 0): its Z is v_z - ω_y.
  expect(gained[9]! - gained[11]!).toBeCloseTo(1, 2);
  expect(gained[11]).toBeLessThan(0);
});
