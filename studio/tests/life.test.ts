// Fish with minds of their own, in Node as in the page: they flee a shark, come to food and eat it, and keep to their place.

import { beforeAll, beforeEach, describe, expect, test, vi } from "vitest";
import type { RootPose, Vector } from "../src/body/root";
import type { Bundle } from "../src/bundle/bundle";
import { sizeOf } from "../src/bundle/layout";
import { Emulator } from "../src/emulator/emulator";
import { Policy } from "../src/emulator/policy";
import { Life, SMALL } from "../src/steering/life";
import { distance, Mind } from "../src/steering/mind";
import { School } from "../src/steering/school";
import { shippedFile } from "./shipped";

const LENGTH = 0.28;
const NOWHERE = { sharks: [], food: [], others: [] };

const AHEAD: RootPose = {
  position: [0, 0, 0],
  velocity: [0, 0, 0],
  forward: [1, 0, 0],
  left: [0, 1, 0],
  up: [0, 0, 1],
  roll: 0,
};

beforeEach(() => {
  let seed = 1;
  vi.spyOn(Math, "random").mockImplementation(() => (seed = (16807 * seed) % 2147483647) / 2147483647);
});

describe("a mind", () => {
  test("sees all but what is behind it or far away", () => {
    const mind = new Mind(LENGTH);
    const place = (degrees: number, lengths: number): Vector => {
      const angle = (degrees * Math.PI) / 180;
      return [lengths * LENGTH * Math.cos(angle), lengths * LENGTH * Math.sin(angle), 0];
    };
    expect([0, 90, 140, 160, 180].map((degrees) => mind.sees(AHEAD, place(degrees, 3)))).toEqual([true, true, true, false, false]);
    expect(mind.sees(AHEAD, place(0, 30))).toBe(false);
  });

  test("fears a shark before it feels hunger, and calms down when it is gone", () => {
    const mind = new Mind(LENGTH, () => 0.9);
    const food: Vector = [LENGTH, 0, 0];
    const shark: Vector = [2 * LENGTH, 0.1, 0];
    const wish = mind.think(AHEAD, { ...NOWHERE, food: [food], sharks: [shark] }, 0.1);
    expect(mind.intention).toBe("escape");
    expect(wish.force[0]).toBeLessThan(0);
    for (let second = 0; second < 12; second++) {
      mind.think(AHEAD, { ...NOWHERE, food: [food] }, 1);
    }
    expect(mind.intention).toBe("eat");
    const hunger = mind.hunger;
    mind.feed();
    expect(mind.hunger).toBeLessThan(hunger);
  });
});

describe("a life of twenty", () => {
  let facts: Bundle;
  let emulator: Emulator;
  let policy: Policy;

  beforeAll(async () => {
    facts = JSON.parse(new TextDecoder().decode(await shippedFile("fish-50/bundle.json"))) as Bundle;
    const sizes = { state: sizeOf(facts.state), control: sizeOf(facts.control), latent: facts.latent };
    emulator = await Emulator.start(await WebAssembly.compile(await shippedFile("fish-50/emulator.wasm")), sizes);
    policy = await Policy.start(await WebAssembly.compile(await shippedFile("fish-50/policy.wasm")), sizes.state, sizes.control);
  });

  function lived(shark: Vector, seconds: number, begin: (life: Life, shark: Vector) => void = () => undefined): Life {
    const school = new School(emulator, policy, facts, LENGTH, { low: -3, high: 3 }, [0, 0, 0], 20);
    const pose = { ...AHEAD, position: shark };
    const life = new Life(school, [0, 0, 0], facts.dt, LENGTH, () => pose, -3 * SMALL);
    begin(life, shark);
    for (let image = 0; image < 60 * seconds; image++) {
      life.advance(1 / 60);
    }
    return life;
  }

  const middle = (life: Life, from: Vector): number =>
    life.minds.reduce((sum, _, i) => sum + distance(life.school.place(i), from), 0) / life.minds.length;

  test("flees from a shark in its midst", () => {
    const shark: Vector = [0, 0, 0];
    const calm = lived([100, 0, 0], 4);
    const frightened = lived(shark, 4);
    expect(middle(frightened, shark)).toBeGreaterThan(1.15 * middle(calm, shark));
  });

  test("eats what is dropped", () => {
    const life = lived([100, 0, 0], 12, (one) => {
      one.minds.forEach((mind) => (mind.hunger = 1));
      one.feed([0, 0, 0]);
    });
    expect(life.eaten).toBeGreaterThan(3);
    expect(life.food.length + life.eaten).toBe(8);
    expect(Math.min(...life.minds.map((mind) => mind.hunger))).toBeLessThan(0.95);
  });

  test("puts a fish that was caught elsewhere, and loses none", () => {
    const life = lived([100, 0, 0], 2, (one, shark) => {
      const [x, y, z] = one.school.place(0);
      shark.splice(0, 3, x * SMALL - 0.4 * LENGTH, y * SMALL, z * SMALL);
    });
    const places = life.minds.map((_, i) => life.school.place(i));
    expect(places.every((place) => place.every(Number.isFinite))).toBe(true);
    expect(Math.max(...places.map((place) => Math.hypot(...place)))).toBeLessThan(30 * LENGTH);
    expect(life.caught).toBeGreaterThan(0);
  });
});
