// A walker that is pushed falls and gets up, however and however long it is pushed: nothing flies.

import { beforeAll, describe, expect, test } from "vitest";
import { rootPose } from "../src/body/root";
import type { Bundle } from "../src/bundle/bundle";
import { sizeOf } from "../src/bundle/layout";
import { Emulator } from "../src/emulator/emulator";
import { CommandedPolicy } from "../src/emulator/policy";
import { Player } from "../src/motion/player";
import { WalkPilot } from "../src/steering/pilots";
import { pullTo } from "../src/steering/push";
import { shippedFile } from "./shipped";

/** Time of walking before the pull, and from its end until he must walk again [s]. */
const BEFORE = 1;
const AFTER = 14;

const IMAGE = 1 / 30;

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

  /** Walk, be pulled at a bone with a wanted velocity [m/s], at most `most` [m/s] in a super step, for some time [s]; return what was seen. */
  function pulled(recorded: Bundle, bone: string, wanted: readonly number[], most: number, seconds: number) {
    const number = facts.skeleton.findIndex((one) => one.name === bone);
    const player = new Player(emulator, recorded);
    const pilot = new WalkPilot(policy, recorded);
    pilot.command.speed = 1;
    player.pilot = pilot;
    player.goesOn = true;
    player.isPlaying = true;
    let isFalling = false;
    let highest = 0;
    let jump = 0;
    let before: Float32Array | null = null;
    while (player.time < BEFORE + seconds + AFTER) {
      const isPulled = player.time > BEFORE && player.time < BEFORE + seconds;
      player.force = isPulled ? (state) => pullTo(recorded, state, number, wanted, most) : null;
      player.advance(IMAGE);
      isFalling ||= player.isRecorded;
      const state = player.state().slice();
      highest = Math.max(highest, state[2]!);
      jump = Math.max(jump, ...(before ?? state).slice(0, 3).map((value, i) => Math.abs(value - state[i]!)));
      before = state;
    }
    return { player, isFalling, highest, jump, pose: rootPose(facts.root!, player.state()) };
  }

  const directions = [0, 1, 2, 3, 4, 5].map((sixth) => (Math.PI / 3) * sixth);
  const pulls = directions.flatMap((angle) =>
    ["torso", "foot_right"].map((bone) => [bone, angle] as const),
  );

  test.each(pulls)("pulled hard at the %s toward %f rad walks again in the end, and never flies", (bone, angle) => {
    const wanted = [2.6 * Math.cos(angle), 2.6 * Math.sin(angle), 1];
    const seen = pulled(facts, bone, wanted, 0.36, 0.4 + 0.5 * Math.abs(Math.sin(angle)));
    expect(seen.highest).toBeLessThan(1.4);
    expect(seen.jump).toBeLessThan(0.25);
    expect(seen.player.isRecorded).toBe(false);
    expect(seen.pose.position[2]).toBeGreaterThan(0.7);
    expect(seen.pose.up[2]).toBeGreaterThan(0.9);
    expect(seen.player.motion.score(seen.player.motion.steps - 1)).toBeLessThan(2);
  });

  test("is pushed as he learnt it, and does not fall", () => {
    const seen = pulled(facts, "torso", [0, 0.5, 0], 0.36, 0.3);
    expect(seen.isFalling).toBe(false);
  });

  test("falls when he is pulled over, and one without recorded falls begins anew where he is", () => {
    expect(pulled(facts, "torso", [0, 2.6, 0], 0.36, 1).isFalling).toBe(true);
    const { falls: _, ...others } = facts;
    const seen = pulled(others, "torso", [0, 2.6, 0], 0.36, 1);
    expect(seen.highest).toBeLessThan(1.4);
    expect(seen.pose.up[2]).toBeGreaterThan(0.9);
    expect(Math.abs(seen.pose.position[1])).toBeGreaterThan(0.2);
  });
});
