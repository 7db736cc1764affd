// Small fish with minds around a steered one, the shark. They swim together, look for food, flee and are caught.
//
// Small fish are the same fish at another scale: a body s times as large, with springs s times as stiff, moves at the same
// speeds in times s times as long, as water resists with the square of speed. So one emulator and one policy move both, and
// this file is in the small fish's own lengths and times.

import { unit, type RootPose, type Vector } from "../body/root";
import { distance, Mind, offset, type Surroundings } from "./mind";
import type { Guide, School, Wish } from "./school";

/** Size of the small fish, over the shark's. */
export const SMALL = 0.4;

/** Number of small fish. */
export const POPULATION = 50;

/** Speed at which food sinks [m/s], and time after which it is gone [s]. */
const SINKING = 0.02;
const SPOILED = 60;

/** Number of morsels in a handful of food, and distance over which it scatters, in lengths. */
const HANDFUL = 8;
const SCATTER = 1.2;

/** Distance of the mouth in front of a body's middle, and its reach; in lengths. */
const MOUTH = 0.4;
const BITE = 0.6;

/** Distance from its mouth within which a shark catches a fish, in lengths of the fish. */
const CATCH = 0.6;

/** Radius of the small fish's home, in their lengths; it follows a shark that leaves it. */
const HOME = 7;

/** Time without steering after which the shark hunts by itself again [s]. */
const PATIENCE = 4;

export interface Morsel {
  readonly place: Vector;
  age: number;
}

export class Life implements Guide {
  readonly minds: readonly Mind[];
  readonly food: Morsel[] = [];
  /** Numbers of morsels eaten, and of fish caught. */
  eaten = 0;
  caught = 0;
  readonly #home: Vector;
  readonly #lost = new Set<number>();
  #idle = PATIENCE;
  #surroundings: Surroundings = { sharks: [], food: [], others: [] };

  /** They begin at `home`, in their lengths; `length` is a body's; `shark` and `low` return the shark's place and the bed [m]. */
  constructor(
    readonly school: School,
    home: Vector,
    private readonly dt: number,
    private readonly length: number,
    private readonly shark: () => RootPose,
    private readonly low: number,
  ) {
    this.minds = Array.from({ length: school.count }, () => new Mind(length));
    this.#home = [...home];
    school.guide = this;
  }

  /** Advance by `seconds` of the world. */
  advance(seconds: number): void {
    const mouth = small(mouthOf(this.shark(), this.length));
    this.#surroundings = {
      sharks: [mouth],
      food: this.food.map((morsel) => morsel.place),
      others: this.minds.map((_, number) => ({ position: this.school.place(number), forward: this.school.forward(number) })),
    };
    this.#followShark(mouth);
    this.school.advance(seconds / SMALL);
    this.#sink(seconds / SMALL);
    this.#lost.forEach((number) => this.#replace(number, mouth));
    this.#lost.clear();
    this.#idle += seconds;
  }

  wish(number: number, pose: RootPose): Wish {
    const mind = this.minds[number]!;
    const mouth = mouthOf(pose, this.length);
    this.#eat(mind, mouth);
    const [shark] = this.#surroundings.sharks;
    if (shark && distance(shark, pose.position) < CATCH * this.length) {
      this.#lost.add(number);
    }
    const others = this.#surroundings.others.filter((_, other) => other !== number);
    const { force, pace } = mind.think(pose, { ...this.#surroundings, others }, this.dt);
    return { force: this.#keptHome(force, pose.position), pace };
  }

  /** Drop a handful of food at a place in the world [m]. */
  feed(place: Vector): void {
    const middle = small(place);
    for (let i = 0; i < HANDFUL; i++) {
      const scattered = middle.map((value) => value + SCATTER * this.length * (2 * Math.random() - 1)) as Vector;
      this.food.push({ place: scattered, age: 0 });
    }
  }

  /** Note that the shark is steered: it hunts by itself only after some seconds alone. */
  hold(): void {
    this.#idle = 0;
  }

  /** Target of the hunting shark in the world [m], the nearest small fish; null while it is steered. */
  get prey(): Vector | null {
    if (this.#idle < PATIENCE) {
      return null;
    }
    const mouth = small(mouthOf(this.shark(), this.length));
    const places = this.minds.map((_, number) => this.school.place(number));
    const nearest = places.reduce((best, place) => (distance(place, mouth) < distance(best, mouth) ? place : best));
    return nearest.map((value) => value * SMALL) as Vector;
  }

  #eat(mind: Mind, mouth: Vector): void {
    const found = this.food.findIndex((morsel) => distance(morsel.place, mouth) < BITE * this.length);
    if (found >= 0) {
      this.food.splice(found, 1);
      mind.feed();
      this.eaten += 1;
    }
  }

  // A caught fish restarts away from the shark.
  #replace(number: number, shark: Vector): void {
    const away = unit(offset(this.#home, shark));
    const angle = Math.atan2(away[1], away[0]) + Math.random() - 0.5;
    const far = 1.3 * HOME * this.length;
    this.school.put(
      number,
      [this.#home[0] + far * Math.cos(angle), this.#home[1] + far * Math.sin(angle), this.#home[2]],
      angle + Math.PI,
    );
    this.caught += 1;
  }

  #sink(seconds: number): void {
    for (const morsel of this.food) {
      morsel.age += seconds;
      morsel.place[2] = Math.max(morsel.place[2] - SINKING * seconds, this.low / SMALL + 0.1 * this.length);
    }
    const fresh = this.food.filter((morsel) => morsel.age < SPOILED / SMALL);
    this.food.splice(0, this.food.length, ...fresh);
  }

  #followShark(shark: Vector): void {
    const reach = 2 * HOME * this.length;
    const away = distance(shark, this.#home);
    if (away > reach) {
      offset(shark, this.#home).forEach((value, axis) => (this.#home[axis]! += (value * (away - reach)) / away));
    }
  }

  // A fish always returns to the others' home.
  #keptHome(force: Vector, position: Vector): Vector {
    const inward = offset(this.#home, position);
    const beyond = Math.hypot(...inward) / (HOME * this.length) - 1;
    if (beyond <= 0) {
      return force;
    }
    const back = unit(inward);
    const pull = 3 * Math.min(beyond, 1);
    return [force[0] + pull * back[0], force[1] + pull * back[1], force[2] + pull * back[2]];
  }
}

/** Return the position of the mouth of a body of that pose and `length` [m]. */
function mouthOf({ position, forward }: RootPose, length: number): Vector {
  return [0, 1, 2].map((axis) => position[axis]! + MOUTH * length * forward[axis]!) as Vector;
}

/** Return a place in the world in the small fish's lengths. */
function small(place: Vector): Vector {
  return place.map((value) => value / SMALL) as Vector;
}
