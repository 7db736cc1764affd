// Walkers: bodies of the same kind as the one on show, walking from place to place around it and avoiding each other.

import { rootPose, type RootPose, type Vector } from "../body/root";
import type { Bundle, Root } from "../bundle/bundle";
import type { Batch, Emulator } from "../emulator/emulator";
import type { CommandedPolicy } from "../emulator/policy";
import { interpolateHermite, type StateStructure } from "../motion/interpolate";
import { turnedBy } from "./fall";
import { clamp } from "./pilots";

/** Maximum distance of walkers from the body on show [m]. */
export const RADIUS = 6;

/** Minimum initial distance from it [m]. */
const INNER_RADIUS = 2;

/** Distance at which a walker has reached its target, and chooses another [m]. */
const ARRIVED = 1;

/** Distance at which two walkers give way to each other [m], and weight of that over reaching the target. */
const CLEARANCE = 1.8;
const SEPARATION = 2;

/** Turn rate over the angle to the target [1/s]; its maximum over the fastest of the policy; and its rate of change [rad/s²]. */
const EAGERNESS = 1.5;
const MAX_TURNING = 0.75;
const TURNING_CHANGE = 1;

/**
 * Slowest and fastest speed, over those of the policy: slow walkers fall most often in turns, and fast runners turn too wide for
 * so small a place.
 */
const SLOWEST = 0.3;
const FASTEST = 0.4;

/** Share of its initial height below which a walker has fallen, and restarts in place. */
const FALLEN = 0.6;

/** Maximum number of super steps each has walked when it appears, so that they do not walk in step. */
const MAX_HEAD_START = 80;

/** Maximum time that is caught up after a pause [s]. */
const MAX_BACKLOG = 0.2;

type FreeRoot = Extract<Root, { kind: "free" }>;

export class Walkers {
  /** Work of emulator and policy, averaged over the last images [ms per image]. */
  workPerImage = 0;
  /** Number of falls so far. */
  falls = 0;
  readonly #batch: Batch;
  readonly #root: FreeRoot;
  readonly #structure: StateStructure;
  /** States (count, S) one super step before those of the batch. */
  #before: Float32Array;
  readonly #goals: Vector[] = [];
  readonly #speeds: number[] = [];
  readonly #turnings: number[] = [];
  readonly #state: Float32Array;
  readonly #places: Vector[] = [];
  #waited = 0;

  /** `leader` returns the position of the body on show [m]. */
  constructor(
    emulator: Emulator,
    private readonly policy: CommandedPolicy,
    private readonly facts: Bundle,
    readonly count: number,
    private readonly leader: () => Vector,
  ) {
    this.#root = freeRoot(facts);
    this.#structure = { rates: facts.rates, orientations: facts.orientations };
    this.#state = new Float32Array(facts.rest.length);
    this.#batch = emulator.batch(count);
    const [, , slowest, fastest] = facts.policy!.command[0]!;
    for (let number = 0; number < count; number++) {
      this.#speeds.push(slowest + (fastest - slowest) * (SLOWEST + (FASTEST - SLOWEST) * Math.random()));
      this.#turnings.push(0);
      // One in every direction.
      const angle = (2 * Math.PI * (number + Math.random())) / count;
      const distance = INNER_RADIUS + (RADIUS - INNER_RADIUS) * Math.random();
      const place: Vector = [distance * Math.cos(angle), distance * Math.sin(angle), 0];
      this.#places.push(place.map((value, axis) => value + leader()[axis]!) as Vector);
      this.#goals.push(this.#somewhere());
      this.#begin(number, this.#afterHeadStart(emulator, number));
    }
    this.#batch.encode();
    this.#before = this.#batch.states.slice();
  }

  /** Advance by `seconds`, and pass each body's state (S) to `show`. */
  advance(seconds: number, show: (number: number, state: Float32Array) => void): void {
    const began = performance.now();
    this.#waited += Math.min(seconds, MAX_BACKLOG);
    while (this.#waited >= this.facts.dt) {
      this.#waited -= this.facts.dt;
      this.#superStep();
    }
    this.show(show);
    this.workPerImage += 0.05 * (performance.now() - began - this.workPerImage);
  }

  /** Pass each body's state (S), between its super steps, to `show`. */
  show(show: (number: number, state: Float32Array) => void): void {
    const { dt } = this.facts;
    const size = this.#state.length;
    const after = this.#batch.states;
    for (let number = 0; number < this.count; number++) {
      const [start, end] = [number * size, (number + 1) * size];
      interpolateHermite(this.#before.subarray(start, end), after.subarray(start, end), this.#waited / dt, dt, this.#structure, this.#state);
      show(number, this.#state);
    }
  }

  /** Position of walker `number` [m]. */
  place(number: number): Vector {
    return this.#places[number]!;
  }

  #superStep(): void {
    const { states, controls } = this.#batch;
    const size = this.#state.length;
    const controlSize = this.facts.control_low.length;
    for (let number = 0; number < this.count; number++) {
      this.#raise(number);
      const state = states.subarray(number * size, (number + 1) * size);
      const pose = rootPose(this.#root, state);
      this.#places[number] = pose.position;
      const told = this.policy.control(state, this.#commandOf(number, pose));
      // Commands are in the state, from which the emulator goes on.
      state.set(told.state);
      controls.set(told.control, number * controlSize);
    }
    this.#batch.encode();
    this.#before = this.#batch.states.slice();
    this.#batch.advance();
  }

  #commandOf(number: number, { position, forward }: RootPose): [speed: number, turning: number] {
    if (distance(position, this.#goals[number]!) < ARRIVED || distance(this.#goals[number]!, this.leader()) > RADIUS) {
      this.#goals[number] = this.#somewhere();
    }
    const goal = this.#goals[number]!;
    const away = this.#awayFromOthers(number, position);
    const far = Math.max(distance(goal, position), 1e-6);
    const along = [0, 1].map((axis) => (goal[axis]! - position[axis]!) / far + SEPARATION * away[axis]!);
    const error = wrapped(Math.atan2(along[1]!, along[0]!) - Math.atan2(forward[1], forward[0]));
    const [, , right, left] = this.facts.policy!.command[1]!;
    const wanted = clamp(EAGERNESS * error, MAX_TURNING * right, MAX_TURNING * left);
    const change = TURNING_CHANGE * this.facts.dt;
    const turning = this.#turnings[number]!;
    this.#turnings[number] = turning + clamp(wanted - turning, -change, change);
    return [this.#speeds[number]!, this.#turnings[number]!];
  }

  #awayFromOthers(number: number, position: Vector): [number, number] {
    const sum: [number, number] = [0, 0];
    const others = this.#places.filter((_, other) => other !== number);
    for (const other of [...others, this.leader()]) {
      const apart = Math.max(distance(position, other), 1e-6);
      const strength = Math.max(1 - apart / CLEARANCE, 0) / apart;
      sum[0] += strength * (position[0] - other[0]);
      sum[1] += strength * (position[1] - other[1]);
    }
    return sum;
  }

  #somewhere(): Vector {
    const angle = 2 * Math.PI * Math.random();
    const far = RADIUS * Math.sqrt(Math.random());
    const [x, y] = this.leader();
    return [x + far * Math.cos(angle), y + far * Math.sin(angle), 0];
  }

  // A fallen walker restarts in place.
  #raise(number: number): void {
    const size = this.#state.length;
    const height = this.#batch.states[number * size + this.#root.position + 2]!;
    const { start } = this.facts.default_motion;
    if (height < FALLEN * start[this.#root.position + 2]!) {
      this.falls += 1;
      this.#begin(number, start);
    }
  }

  // Restart walker `number` in place, in `state` (S), facing its target.
  #begin(number: number, state: ArrayLike<number>): void {
    const goal = this.#goals[number]!;
    const [x, y] = this.#places[number]!;
    const turned = turnedTo(this.#root, state, Math.atan2(goal[1] - y, goal[0] - x));
    turned[this.#root.position] = x;
    turned[this.#root.position + 1] = y;
    this.#batch.states.set(turned, number * turned.length);
  }

  // The state (S) after a walk of random length straight ahead.
  #afterHeadStart(emulator: Emulator, number: number): ArrayLike<number> {
    let state: ArrayLike<number> = this.facts.default_motion.start;
    const steps = Math.floor(MAX_HEAD_START * Math.random());
    for (let step = 0; step < steps; step++) {
      const told = this.policy.control(state, [this.#speeds[number]!, 0]);
      state = emulator.step(told.state, told.control);
    }
    return state;
  }
}

function freeRoot(facts: Bundle): FreeRoot {
  if (facts.root?.kind !== "free") {
    throw new Error("walkers have a free root");
  }
  return facts.root;
}

/** Return a state (S) turned about the vertical so that the body faces `heading` [rad]. */
function turnedTo(root: FreeRoot, state: ArrayLike<number>, heading: number): Float32Array {
  const { forward } = rootPose(root, state);
  return turnedBy(root, state, heading - Math.atan2(forward[1], forward[0]));
}

function wrapped(angle: number): number {
  return angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
}

/** Distance along the ground [m]. */
function distance(one: Vector, other: Vector): number {
  return Math.hypot(one[0] - other[0], one[1] - other[1]);
}
