// Movers of a soft body: led by a hand they stay within their bounds and arrive, left alone they wander as they were shown.

import { beforeEach, describe, expect, test } from "vitest";
import type { Bundle } from "../src/bundle/bundle";
import { Motion } from "../src/motion/motion";
import { Crowd } from "../src/steering/crowd";
import { MoverPilot, WanderPath } from "../src/steering/movers";
import { pendulum } from "./shipped";

const DT = 1 / 30;
const STEPS = 120;

/** A ball and a pole, whose velocities are the controls; nothing else. */
const FACTS = {
  dt: DT,
  rest: [0, 0.6, 1, 0, 0, 1.5],
  control_low: [-1, -1, -1, -0.5, -0.5, -0.5],
  control_high: [1, 1, 1, 0.5, 0.5, 0.5],
  rates: [],
  orientations: [],
  movers: [
    ["ball", 0, 0, 3],
    ["pole", 3, 3, 3],
  ],
} as unknown as Bundle;

/** Positions go where velocities take them: known exactly, as to every emulator of a soft body. */
function moved(state: Float32Array, control: ArrayLike<number>): Float32Array {
  return state.map((value, i) => value + DT * control[i]!);
}

/** A circle of the ball, and a sway of the pole. */
function circle(): Motion {
  const motion = new Motion(DT, 6, 6, { rates: [], orientations: [] }, FACTS.rest);
  for (let step = 0; step < STEPS; step++) {
    const angle = (2 * Math.PI * (step + 0.5)) / STEPS;
    const control = [0.5 * Math.cos(angle), 0.5 * Math.sin(angle), 0, 0.2 * Math.cos(angle), 0, 0];
    motion.append(control, moved(motion.state(step), control), 0);
  }
  return motion;
}

describe("a pilot of movers", () => {
  let pilot: MoverPilot;
  let state: Float32Array;
  let path: WanderPath;

  beforeEach(() => {
    path = new WanderPath(circle(), FACTS);
    pilot = new MoverPilot(FACTS, path);
    state = Float32Array.from(FACTS.rest);
  });

  function play(seconds: number, check: (control: Float32Array) => void = () => undefined): void {
    for (let step = 0; step < seconds / DT; step++) {
      const control = pilot.control(state);
      check(control);
      state = moved(state, control);
    }
  }

  test("keeps within the bounds wherever it leads, and arrives", () => {
    for (const target of [[2, -3, 1], [0, 0, 0.5], [1e6, 0, 0]]) {
      pilot.lead(0, target);
      play(6, (control) => {
        control.forEach((value, i) => expect(Math.abs(value)).toBeLessThanOrEqual(FACTS.control_high[i]! + 1e-6));
        expect(Math.hypot(...control.subarray(3))).toBe(0);
      });
      if (target[0]! < 10) {
        target.forEach((value, axis) => expect(state[axis]).toBeCloseTo(value, 2));
      }
    }
  });

  test("stops when it is let go of, and wanders back to its path after a while", () => {
    pilot.lead(0, [1, 1, 1]);
    play(3);
    pilot.release();
    play(1, (control) => expect(Math.hypot(...control)).toBeLessThan(0.01));
    play(20);
    expect(pilot.isWandering).toBe(true);
    const there = path.state(path.nearest(state));
    expect(Math.hypot(...state.map((value, i) => value - there[i]!))).toBeLessThan(0.05);
  });

  test("left alone follows the path it was shown, round after round", () => {
    const before = state.slice();
    play(STEPS * DT * 2 - DT / 2);
    state.forEach((value, i) => expect(value).toBeCloseTo(before[i]!, 2));
    play((STEPS * DT) / 2 - DT / 2);
    expect(Math.hypot(state[0]! - before[0]!, state[1]! - before[1]!)).toBeGreaterThan(0.3);
  });

  test("keys move the mover that was held last, with all of its velocity at most", () => {
    pilot.lead(1, [0, 0, 1.5]);
    pilot.release();
    pilot.push([1, -1, 0.5]);
    play(1);
    [0, 0, 0, 0.5, -0.5, 0.25].forEach((value, i) => expect(pilot.control(state)[i]).toBeCloseTo(value, 3));
    pilot.push(null);
    play(1);
    expect(Math.hypot(...pilot.control(state))).toBeLessThan(0.001);
  });

  test("takes up a velocity as softly as training has it", () => {
    let before = 0;
    pilot.lead(0, [3, 0.6, 1]);
    play(1, ([control]) => {
      expect(Math.abs(control! - before)).toBeLessThan(0.3);
      before = control!;
    });
    expect(before).toBeGreaterThan(0.9);
  });
});

test("each of a crowd goes where the emulator alone goes, from a place of its own on the path", async () => {
  const { emulator, facts, player } = await pendulum();
  const path = new WanderPath(player.motion, facts);
  const crowd = new Crowd(emulator, facts, path, 20);
  const states: Float32Array[] = [];
  const show = (number: number, state: Float32Array): void => void (states[number] = state.slice());
  crowd.show(show);
  const starts = [...states];
  expect(new Set(starts.map((state) => state.join())).size).toBe(20);
  const steps = 10;
  for (let image = 0; image < 2 * steps; image++) {
    crowd.advance(facts.dt / 2, show);
  }
  const step = Array.from({ length: path.steps }, (_, i) => i).find((i) => path.state(i).every((value, k) => value === starts[0]![k]))!;
  // Between two super steps is drawn what lies between them: one behind.
  let alone = starts[0]!;
  for (let i = 0; i < steps - 1; i++) {
    alone = emulator.step(alone, path.control(step + i));
  }
  states[0]!.forEach((value, i) => expect(value).toBeCloseTo(alone[i]!, 3));
});

/** A bone: its position, its quaternion, and the six rates that are its controls. */
const BONE = {
  dt: DT,
  rest: [0, 0, 1, 1, 0, 0, 0],
  control_low: [-1, -1, -1, -2, -2, -2],
  control_high: [1, 1, 1, 2, 2, 2],
  rates: [],
  orientations: [],
  movers: [["bone", 0, 0, 6]],
} as unknown as Bundle;

/** The bone after a super step: its quaternion is turned by a Rodrigues vector along its own axes. */
function turned(state: Float32Array, control: ArrayLike<number>): Float32Array<ArrayBuffer> {
  const [w, x, y, z] = state.subarray(3) as unknown as [number, number, number, number];
  const [a, b, c] = [3, 4, 5].map((i) => (DT / 2) * control[i]!) as [number, number, number];
  const quaternion = [w - x * a - y * b - z * c, w * a + x + y * c - z * b, w * b - x * c + y + z * a, w * c + x * b - y * a + z];
  const length = Math.hypot(...quaternion);
  const position = [0, 1, 2].map((i) => state[i]! + DT * control[i]!);
  return Float32Array.from([...position, ...quaternion.map((number) => number / length)]);
}

test("a bone that turns freely comes back to its path, whatever the sign of its quaternion", () => {
  const motion = new Motion(DT, 7, 6, { rates: [], orientations: [] }, BONE.rest);
  for (let step = 0; step < STEPS; step++) {
    const angle = (2 * Math.PI * (step + 0.5)) / STEPS;
    const control = [0.3 * Math.cos(angle), 0, 0, 0.8 * Math.cos(angle), 0, 0];
    motion.append(control, turned(motion.state(step), control), 0);
  }
  const path = new WanderPath(motion, BONE);
  const pilot = new MoverPilot(BONE, path);
  const lean = Math.sin(0.4);
  let state = Float32Array.from([0.2, 0.1, 1.1, -Math.cos(0.4), -0.6 * lean, 0, -0.8 * lean]);
  for (let step = 0; step < 12 / DT; step++) {
    state = turned(state, pilot.control(state));
  }
  const there = path.state(path.nearest(state));
  const along = [3, 4, 5, 6].reduce((sum, i) => sum + state[i]! * there[i]!, 0);
  expect(Math.abs(along)).toBeGreaterThan(0.999);
  [0, 1, 2].forEach((i) => expect(state[i]).toBeCloseTo(there[i]!, 1));
});
