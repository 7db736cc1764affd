// Motions keep what is put into them, and stay at their ends.

import { expect, test } from "vitest";
import { Motion } from "../src/motion/motion";
import { pendulum } from "./shipped";

const STRUCTURE = { rates: [[0, 1]] as const, orientations: [] };

/** A falling point: position and velocity. */
function fall(steps: number): Motion {
  const motion = new Motion(0.1, 2, 1, STRUCTURE, [0, 0]);
  for (let step = 1; step <= steps; step++) {
    const time = 0.1 * step;
    motion.append([step], [-5 * time * time, -10 * time], (step + 1) % 2);
  }
  return motion;
}

test("a fall is a parabola between super steps too", () => {
  const motion = fall(8);
  const state = new Float32Array(2);
  motion.sample(0.437, state);
  expect(state[0]).toBeCloseTo(-5 * 0.437 ** 2, 6);
  expect(state[1]).toBeCloseTo(-4.37, 5);
});

test("before the start and after the end a motion stays", () => {
  const motion = fall(3);
  const state = new Float32Array(2);
  motion.sample(-1, state);
  expect([...state]).toEqual([0, 0]);
  motion.sample(9, state);
  expect(state[0]).toBeCloseTo(-0.45, 6);
});

test("a motion grows beyond its first room and keeps all of it", () => {
  const motion = fall(1000);
  expect(motion.steps).toBe(1000);
  expect(motion.control(0)[0]).toBe(1);
  expect(motion.control(999)[0]).toBe(1000);
  expect(motion.score(998)).toBe(0);
  expect(motion.score(999)).toBe(1);
});

test("a motion cut off is the same up to there", () => {
  const whole = fall(10);
  const part = whole.upTo(4);
  expect(part.steps).toBe(4);
  expect([...part.states()]).toEqual([...whole.states().subarray(0, 10)]);
  expect([...part.controls()]).toEqual([1, 2, 3, 4]);
});

test("pushes are kept beside the states they changed, and go along with what is cut off", () => {
  const motion = fall(3);
  motion.pushLast([0, 2]);
  motion.pushLast([0, 1]);
  expect(motion.state(3)[1]).toBeCloseTo(-3 + 3, 5);
  motion.append([4], [-1, 0], 0.5);
  expect(motion.pushes()).toEqual([[3, [0, 3]]]);
  expect(motion.pushes(2, 4)).toEqual([[1, [0, 3]]]);
  expect(motion.pushes(0, 3)).toEqual([]);
  expect(motion.upTo(2).pushes()).toEqual([]);
  const part = motion.upTo(3);
  part.append([4], [-1, 0], 0.5);
  expect(part.pushes()).toEqual([[3, [0, 3]]]);
});

test("a push at the start is another start", () => {
  const motion = fall(0);
  motion.pushLast([1, 0]);
  motion.append([1], [1, 0], 0.5);
  expect(motion.state(0)[0]).toBe(1);
  expect(motion.pushes()).toEqual([]);
});

test("what was found stands on its last frame, and the default motion begins again", async () => {
  const { player } = await pendulum();
  player.isPlaying = true;
  player.seek(player.motion.duration - 0.01);
  player.advance(0.05);
  expect(player.time).toBeCloseTo(0.04, 5);
  player.show(player.motion.upTo(10));
  player.isPlaying = true;
  player.seek(player.motion.duration - 0.01);
  player.advance(0.05);
  expect(player.time).toBe(player.motion.duration);
  expect(player.isPlaying).toBe(false);
});
