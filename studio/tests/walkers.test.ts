// A human walks on command in the emulator alone: the commanded way, at the commanded speed, and so do ten at once.

import { afterEach, beforeAll, describe, expect, test, vi } from "vitest";
import { rootPose, type RootPose } from "../src/body/root";
import type { Bundle } from "../src/bundle/bundle";
import { sizeOf } from "../src/bundle/layout";
import { Emulator } from "../src/emulator/emulator";
import { CommandedPolicy } from "../src/emulator/policy";
import { Player } from "../src/motion/player";
import { WalkPilot } from "../src/steering/pilots";
import { RADIUS, Walkers } from "../src/steering/walkers";
import { shippedFile } from "./shipped";

/** Length of a walk [s]. */
const SECONDS = 20;

/** Time until a commanded speed has come true: it changes by 2 m/s in a second [s]. */
const SETTLED = 2;

/** A root that is lower has fallen [m]. */
const FALLEN = 0.6;

const IMAGE = 1 / 60;

describe("a human", () => {
  let facts: Bundle;
  let emulator: Emulator;
  let policy: CommandedPolicy;

  beforeAll(async () => {
    facts = JSON.parse(new TextDecoder().decode(await shippedFile("human/bundle.json"))) as Bundle;
    const sizes = { state: sizeOf(facts.state), control: sizeOf(facts.control), latent: facts.latent };
    emulator = await Emulator.start(await WebAssembly.compile(await shippedFile("human/emulator.wasm")), sizes);
    const module = await WebAssembly.compile(await shippedFile("human/policy.wasm"));
    policy = await CommandedPolicy.start(module, sizes.state, sizes.control, facts.policy!.command.length);
  });

  afterEach(() => {
    vi.restoreAllMocks();
  });

  function walk(speed: number, turning: number): { poses: RootPose[]; player: Player; mostDoubt: number } {
    const player = new Player(emulator, facts);
    const pilot = new WalkPilot(policy, facts);
    Object.assign(pilot.command, { speed, turning });
    player.pilot = pilot;
    player.goesOn = true;
    player.isPlaying = true;
    const poses: RootPose[] = [];
    while (player.time < SECONDS) {
      player.advance(IMAGE);
      poses.push(rootPose(facts.root!, player.state().slice()));
    }
    const scores = Array.from({ length: player.motion.steps }, (_, step) => player.motion.score(step));
    return { poses, player, mostDoubt: Math.max(...scores) };
  }

  test.each([
    [0.5, 0],
    [0.75, 0.6],
    [1, -0.6],
    [2.4, 0.5],
  ])("walks for 20 s at %f m/s, turning left by %f rad/s, and nothing of it is beyond training", (speed, turning) => {
    const { poses, mostDoubt } = walk(speed, turning);
    expect(Math.min(...poses.map((pose) => pose.position[2]))).toBeGreaterThan(FALLEN);
    let length = 0;
    let turned = 0;
    for (let i = Math.round(SETTLED / IMAGE); i < poses.length; i++) {
      const [before, after] = [poses[i - 1]!, poses[i]!];
      length += Math.hypot(after.position[0] - before.position[0], after.position[1] - before.position[1]);
      const turn = Math.atan2(after.forward[1], after.forward[0]) - Math.atan2(before.forward[1], before.forward[0]);
      turned += turn - 2 * Math.PI * Math.round(turn / (2 * Math.PI));
    }
    const seconds = SECONDS - SETTLED;
    expect(Math.abs(length / seconds - speed)).toBeLessThan(0.15);
    expect(turned / seconds).toBeGreaterThan(turning - 0.1);
    expect(turned / seconds).toBeLessThan(turning + 0.1);
    expect(mostDoubt).toBeLessThan(3);
  });

  test("makes the same motion again from its start, controls and what was told", () => {
    const { motion } = walk(0.8, 0.3).player;
    const again = new Player(emulator, facts).motionFrom(motion.state(0), motion.controls(), motion.pushes());
    expect(again.states()).toEqual(motion.states());
  });

  test("is one of ten who walk around, none of whom falls or walks away", () => {
    let seed = 1;
    vi.spyOn(Math, "random").mockImplementation(() => (seed = (16807 * seed) % 2147483647) / 2147483647);
    const leader = [1, 2, 0.9] as [number, number, number];
    const walkers = new Walkers(emulator, policy, facts, 10, () => leader);
    const seen = new Set<number>();
    for (let time = 0; time < SECONDS; time += IMAGE) {
      walkers.advance(IMAGE, (number, state) => {
        seen.add(number);
        expect(state[2]).toBeGreaterThan(FALLEN);
      });
    }
    expect(seen.size).toBe(10);
    expect(walkers.falls).toBe(0);
    for (const number of seen) {
      const [x, y] = walkers.place(number);
      expect(Math.hypot(x - leader[0], y - leader[1])).toBeLessThan(RADIUS + 2);
    }
  });
});
