// Physics goes on where the emulator is lost, and gives way again. The "physics" here is the pendulum's own emulator.

import { expect, test } from "vitest";
import type { Emulator } from "../src/emulator/emulator";
import { HandOver } from "../src/physics/hand_over";
import type { Drive, Physics } from "../src/physics/physics";
import { pendulum } from "./shipped";

function physicsBy(emulator: Emulator): { physics: Physics; asked: number[][] } {
  const asked: number[][] = [];
  const replay: Physics["replay"] = async ({ start, controls }: Drive) => {
    asked.push(Array.from(controls));
    return { states: emulator.rollout(start, controls), seconds: 0, usualSeconds: 0 };
  };
  return { physics: { isReady: true, replay }, asked };
}

async function until(isTrue: () => boolean): Promise<void> {
  while (!isTrue()) {
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
}

test("physics goes on from the playhead with the controls that were recorded", async () => {
  const { player, facts, emulator } = await pendulum();
  const recorded = player.motion;
  player.seek(10.5 * facts.dt);
  const { physics, asked } = physicsBy(emulator);
  const handOver = HandOver.begin(physics, facts, player, () => undefined);
  await until(() => player.motion.steps > 5);
  expect(player.isHeld).toBe(true);
  expect(player.motion.source).toBe("physics");
  expect([...player.motion.state(0)]).toEqual([...recorded.state(10)]);
  expect(asked[3]).toEqual([...recorded.control(13)]);
  expect([...player.motion.state(4)]).toEqual([...emulator.rollout(recorded.state(10), asked.slice(0, 4).flat())].slice(-6));
  expect([...handOver.origin!]).toEqual([...recorded.state(0)]);
  player.undo();
  await until(() => !player.isHeld);
  expect(handOver.origin).toBeNull();
});

test("physics that does not come leaves what was there", async () => {
  const { player, facts } = await pendulum();
  const recorded = player.motion;
  const lines: string[] = [];
  const replay: Physics["replay"] = () => Promise.reject(new Error("the server does not answer"));
  HandOver.begin({ isReady: true, replay }, facts, player, (line) => lines.push(line));
  await until(() => lines.length > 0);
  expect(lines).toEqual(["the server does not answer"]);
  expect(player.motion).toBe(recorded);
  expect(player.isHeld).toBe(false);
});
