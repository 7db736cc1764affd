// Poses and states between super steps are what Python says they are (vectors/write.py).

import { describe, expect, test } from "vitest";
import { emptyPose, poseBones } from "../src/body/pose";
import type { Bone, Pairs } from "../src/bundle/bundle";
import { interpolateHermite } from "../src/motion/interpolate";
import fish from "./vectors/fish.json";
import pendulum from "./vectors/pendulum.json";
import truck from "./vectors/truck.json";

interface Vectors {
  dt: number;
  rates: Pairs;
  orientations: Pairs;
  skeleton: Bone[];
  states: number[][];
  shares: number[];
  between: number[][];
  positions: number[][];
  quaternions: number[][];
}

/** States are float32 in the page. */
const TOLERANCE = 3e-6;

const SYSTEMS = { fish, truck, pendulum };

function largestDifference(a: ArrayLike<number>, b: ArrayLike<number>): number {
  expect(a.length).toBe(b.length);
  let largest = 0;
  for (let i = 0; i < a.length; i++) {
    largest = Math.max(largest, Math.abs(a[i]! - b[i]!) / (1 + Math.abs(b[i]!)));
  }
  return largest;
}

describe.each(Object.keys(SYSTEMS) as (keyof typeof SYSTEMS)[])("%s", (system) => {
  const vectors = SYSTEMS[system] as unknown as Vectors;

  test("a state between two super steps is the one of Python", () => {
    vectors.shares.forEach((share, i) => {
      const out = new Float64Array(vectors.states[0]!.length);
      interpolateHermite(vectors.states[0]!, vectors.states[1]!, share, vectors.dt, vectors, out);
      expect(largestDifference(out, vectors.between[i]!)).toBeLessThan(TOLERANCE);
    });
  });

  test("bones are where Python says they are", () => {
    vectors.between.forEach((state, i) => {
      const pose = emptyPose(vectors.skeleton.length);
      poseBones(vectors.skeleton, state, pose);
      expect(largestDifference(pose.positions, vectors.positions[i]!)).toBeLessThan(TOLERANCE);
      expect(quaternionDifference(pose.orientations, vectors.quaternions[i]!)).toBeLessThan(1e-5);
    });
  });
});

/** A quaternion and its negative are the same orientation. */
function quaternionDifference(a: ArrayLike<number>, b: ArrayLike<number>): number {
  let largest = 0;
  for (let i = 0; i < a.length; i += 4) {
    const dot = [0, 1, 2, 3].reduce((sum, j) => sum + a[i + j]! * b[i + j]!, 0);
    largest = Math.max(largest, 1 - Math.abs(dot));
  }
  return largest;
}
