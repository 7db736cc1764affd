// Perception, mental state and intentions of a fish, after Tu and Terzopoulos, Artificial fishes (SIGGRAPH 94): it sees within
// a cone, hunger and fear come and go, and one intention at a time gives its direction and speed.

import { dot, unit, type RootPose, type Vector } from "../body/root";
import { clamp } from "./pilots";
import type { Wish } from "./school";

export type Intention = "escape" | "school" | "eat" | "wander";

/** Surroundings of a fish [m]. */
export interface Surroundings {
  readonly sharks: readonly Vector[];
  readonly food: readonly Vector[];
  /** Positions and directions of the others. */
  readonly others: readonly { readonly position: Vector; readonly forward: Vector }[];
}

/** Range of sight, in body lengths, and half the angle of the cone that a fish sees [rad]: all but what is behind it. */
const SIGHT = 9;
const HALF_CONE = (150 / 180) * Math.PI;

/** Distance of full fear of a shark, in body lengths; fear falls as one over distance. */
const FEARED = 2.5;

/** Fear above which a fish flees, and above which it seeks company. */
const FLIGHT = 0.6;
const UNEASE = 0.32;

/** Time constant with which fear fades once no danger is seen [s]. */
const CALMING = 2.5;

/** Time in which a full fish becomes fully hungry [s], and decrease of hunger per morsel. */
const DIGESTION = 40;
const MORSEL = 0.4;

/** Hunger above which a fish leaves the school for food it sees. */
const APPETITE = 0.25;

/** Shares of the fastest speed at which fish stroll, swim with others, feed and flee. */
const PACES: Record<Intention, number> = { wander: 0.5, school: 0.65, eat: 0.85, escape: 1 };

/** Distance from food at which a fish slows down, in lengths, and its minimum share of its pace: fast, it would circle it. */
const SLOWING = 3;
const SLOWEST = 0.4;

/** Weight of food over that of keeping apart. */
const GREED = 3;

/** Minimum time for which an intention is kept [s], as constant changes would lead nowhere; not in fear. */
const PERSISTENCE = 1.2;

/** Distance that a fish of a school keeps from its neighbours, in lengths. */
const COMPANY = 2;

/** Rates [rad/s] and widths [rad] of the two slow waves of a stroll. */
const STROLL = [
  { rate: 0.37, width: 0.8 },
  { rate: 0.83, width: 0.4 },
] as const;

export class Mind {
  /** Hunger, 0 to 1. */
  hunger: number;
  /** Fear, 0 to 1. */
  fear = 0;
  intention: Intention = "wander";
  #kept = 0;
  #time = 0;
  readonly #phases: readonly number[];

  /** `random` gives numbers from 0 to 1, which make fish differ. */
  constructor(
    private readonly length: number,
    random: () => number = Math.random,
  ) {
    this.hunger = 0.7 * random();
    this.#phases = [0, 0, 0, 0].map(() => 2 * Math.PI * random());
  }

  /** Advance by `seconds` in `surroundings`, and return its current wish. */
  think(pose: RootPose, surroundings: Surroundings, seconds: number): Wish {
    this.#time += seconds;
    this.#kept += seconds;
    this.hunger = Math.min(1, this.hunger + seconds / DIGESTION);
    const shark = this.#nearest(pose, surroundings.sharks);
    const food = this.#nearest(pose, surroundings.food);
    const frightening = shark ? Math.min(1, (FEARED * this.length) / distance(shark, pose.position)) : 0;
    this.fear = Math.max(frightening, this.fear * Math.exp(-seconds / CALMING));
    this.#decide(shark !== null, food !== null);
    return { force: this.#force(pose, surroundings, shark, food), pace: this.#pace(pose, food) };
  }

  /** It has eaten a morsel. */
  feed(): void {
    this.hunger = Math.max(0, this.hunger - MORSEL);
  }

  /** Return whether a fish of that pose sees a place [m]. */
  sees(pose: RootPose, place: Vector): boolean {
    const away = distance(place, pose.position);
    if (away > SIGHT * this.length || away === 0) {
      return false;
    }
    return dot(offset(place, pose.position), pose.forward) / away > Math.cos(HALF_CONE);
  }

  #nearest(pose: RootPose, places: readonly Vector[]): Vector | null {
    let nearest: Vector | null = null;
    for (const place of places) {
      if (this.sees(pose, place) && (!nearest || distance(place, pose.position) < distance(nearest, pose.position))) {
        nearest = place;
      }
    }
    return nearest;
  }

  // Danger before hunger before company: the order of the paper's intention generator.
  #decide(seesShark: boolean, seesFood: boolean): void {
    const wanted = this.#wanted(seesShark, seesFood);
    const isUrgent = wanted === "escape" || (this.intention === "eat" && !seesFood);
    if (wanted !== this.intention && (isUrgent || this.#kept > PERSISTENCE)) {
      this.intention = wanted;
      this.#kept = 0;
    }
  }

  #wanted(seesShark: boolean, seesFood: boolean): Intention {
    if (seesShark && this.fear > FLIGHT) {
      return "escape";
    }
    if (this.fear > UNEASE) {
      return "school";
    }
    if (this.hunger > APPETITE && seesFood) {
      return "eat";
    }
    // A hungry fish looks for food by itself; one that is full swims with the others.
    return this.hunger > 2 * APPETITE ? "wander" : "school";
  }

  #pace({ position }: RootPose, food: Vector | null): number {
    const pace = PACES[this.intention];
    if (this.intention !== "eat" || !food) {
      return pace;
    }
    return pace * clamp(distance(food, position) / (SLOWING * this.length), SLOWEST, 1);
  }

  #force(pose: RootPose, { others }: Surroundings, shark: Vector | null, food: Vector | null): Vector {
    switch (this.intention) {
      case "escape":
        return shark ? this.#flight(pose, shark) : pose.forward;
      case "eat":
        return food ? unit(offset(food, pose.position)).map((value) => GREED * value) as Vector : pose.forward;
      case "school":
        return this.#company(pose, others);
      case "wander":
        return this.#stroll(pose);
    }
  }

  // Away from it and aside: fleeing straight from a faster shark would fail.
  #flight(pose: RootPose, shark: Vector): Vector {
    const away = unit(offset(pose.position, shark));
    const side = dot(away, pose.left) < 0 ? -1 : 1;
    return unit([away[0] + 0.5 * side * pose.left[0], away[1] + 0.5 * side * pose.left[1], away[2]]);
  }

  // Reynolds' three rules: alignment, cohesion, and separation from the nearest.
  #company(pose: RootPose, others: Surroundings["others"]): Vector {
    const sum = this.#stroll(pose).map((value) => 0.4 * value) as Vector;
    for (const { position, forward } of others) {
      if (!this.sees(pose, position)) {
        continue;
      }
      const to = offset(position, pose.position);
      const away = Math.hypot(...to) / this.length;
      const pull = clamp((away - COMPANY) / COMPANY, -1, 1) / (1 + away * away);
      for (let axis = 0; axis < 3; axis++) {
        sum[axis]! += forward[axis]! / (1 + away * away) + (pull * to[axis]!) / (away * this.length);
      }
    }
    return sum;
  }

  #stroll(pose: RootPose): Vector {
    const [slow, quick] = STROLL;
    const [a, b, c, d] = this.#phases as [number, number, number, number];
    const wave = (first: number, second: number): number =>
      slow.width * Math.sin(slow.rate * this.#time + first) + quick.width * Math.sin(quick.rate * this.#time + second);
    const heading = Math.atan2(pose.forward[1], pose.forward[0]) + wave(a, b);
    return [Math.cos(heading), Math.sin(heading), 0.3 * wave(c, d)];
  }
}

export function distance(a: Vector, b: Vector): number {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

export function offset(to: Vector, from: Vector): Vector {
  return [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
}
