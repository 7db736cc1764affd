// A school: many swimmers, each moved by the policy of its kind, that keep apart, keep level and swim together.

import { commandToward, rootPose, unit, type RootPose, type Vector } from "../body/root";
import { multiply, rotate } from "../body/quaternion";
import type { Bundle } from "../bundle/bundle";
import type { Batch, Emulator } from "../emulator/emulator";
import type { Policy } from "../emulator/policy";
import { clamp } from "./pilots";

/** Number of groups, which take turns, so that every image has the same work. */
const GROUPS = 6;

/** Distance between swimmers in the school, in lengths. */
const SPACING = 1.6;

/** Distance at which two swimmers give way to each other, in lengths. */
const CLEARANCE = 1.3;

/** Weight of keeping apart, over that of swimming along. */
const SEPARATION = 2.5;

/** Maximum turn and climb in a command [rad]. */
const MAX_TURN = 0.8;
const MAX_CLIMB = 0.3;

/** Slowest and fastest pace of swimmers, over the fastest of their policy. */
const PACES = [0.55, 0.85] as const;

/** Maximum time that is caught up after a pause [s]. */
const MAX_BACKLOG = 0.2;

/** The water in which a school stays [m]. */
export interface Room {
  readonly low: number;
  readonly high: number;
}

export interface Group {
  readonly batch: Batch;
  /** States (count, S) one super step before those of the batch. */
  before: Float32Array;
  /** Called after each super step. */
  onStep: () => void;
  readonly first: number;
  step: number;
  waited: number;
}

/** Wanted direction of a swimmer, and its speed over the fastest of its policy. */
export interface Wish {
  readonly force: Vector;
  readonly pace: number;
}

/** Gives the swimmers of a school their directions, instead of circling around its centre. */
export interface Guide {
  /** The wish of swimmer `number` at `pose`; called once per super step. */
  wish(number: number, pose: RootPose): Wish;
}

export class School {
  readonly groups: Group[] = [];
  readonly count: number;
  /** Work of emulator and policy, averaged over the last images [ms per image]. */
  workPerImage = 0;
  /** Target of the school [m]; it circles if null. */
  target: Vector | null = null;
  guide: Guide | null = null;

  readonly #centre: Vector;
  readonly #radius: number;
  readonly #halfHeight: number;
  readonly #radii: Float32Array;
  readonly #places: Float32Array;
  readonly #forwards: Float32Array;
  readonly #paces: Float32Array;
  readonly #offsets: Float32Array;
  readonly #cells = new Map<number, number[]>();
  readonly #control: Float32Array;

  constructor(
    emulator: Emulator,
    private readonly policy: Policy,
    private readonly facts: Bundle,
    private readonly length: number,
    private readonly room: Room,
    centre: Vector,
    count: number,
  ) {
    this.count = count;
    this.#radius = Math.max(3, 1.3 * Math.cbrt(count)) * length;
    this.#halfHeight = Math.min(0.35 * this.#radius, (room.high - room.low) / 2 - length);
    const middle = clamp(centre[2], room.low + length + this.#halfHeight, room.high - length - this.#halfHeight);
    this.#centre = [centre[0], centre[1], middle];
    this.#radii = Float32Array.from({ length: count }, () => this.#radius * Math.sqrt(0.05 + 0.95 * Math.random()));
    this.#places = new Float32Array(3 * count);
    this.#forwards = new Float32Array(3 * count);
    this.#paces = Float32Array.from({ length: count }, () => PACES[0] + (PACES[1] - PACES[0]) * Math.random());
    this.#offsets = Float32Array.from({ length: 3 * count }, () => 2 * Math.random() - 1);
    this.#control = new Float32Array(facts.control_low.length);
    let first = 0;
    for (let i = 0; i < GROUPS && first < count; i++) {
      const size = Math.ceil((count - first) / (GROUPS - i));
      this.groups.push(this.#makeGroup(emulator.batch(size), first, i / GROUPS));
      first += size;
    }
  }

  /** Advance by `seconds`. */
  advance(seconds: number): void {
    const before = performance.now();
    for (const group of this.groups) {
      group.waited += Math.min(seconds, MAX_BACKLOG);
      while (group.waited >= this.facts.dt) {
        group.waited -= this.facts.dt;
        this.#superStep(group);
      }
    }
    this.workPerImage += 0.05 * (performance.now() - before - this.workPerImage);
  }

  /** Distance of the outermost swimmers from the middle of the school [m]. */
  get radius(): number {
    return this.#radius;
  }

  /** Mean position of the swimmers [m]. */
  get middle(): Vector {
    const sums = [0, 0, 0] as Vector;
    this.#places.forEach((value, i) => (sums[i % 3]! += value));
    return sums.map((sum) => sum / this.count) as Vector;
  }

  /** Position of swimmer `number` [m]. */
  place(number: number): Vector {
    return triple(this.#places, number);
  }

  /** Direction of swimmer `number`. */
  forward(number: number): Vector {
    return triple(this.#forwards, number);
  }

  /** Put swimmer `number` at `place` [m], at rest, at `heading` [rad] about the vertical. */
  put(number: number, place: Vector, heading: number): void {
    const group = this.groups.findLast((one) => one.first <= number)!;
    const state = moved(this.facts, heading, place);
    for (const states of [group.before, group.batch.states]) {
      states.set(state, (number - group.first) * state.length);
    }
    group.batch.encode();
    group.onStep();
    this.#places.set(place, 3 * number);
  }

  // A group at rest, at random places around the centre, all heading along the circle.
  #makeGroup(batch: Batch, first: number, share: number): Group {
    const { facts } = this;
    const size = facts.rest.length;
    for (let body = 0; body < batch.count; body++) {
      const angle = 2 * Math.PI * Math.random();
      const distance = this.#radii[first + body]!;
      const depth = this.#halfHeight * this.#offsets[3 * (first + body) + 2]!;
      const place: Vector = [
        this.#centre[0] + distance * Math.cos(angle),
        this.#centre[1] + distance * Math.sin(angle),
        this.#centre[2] + depth,
      ];
      const heading = angle + Math.PI / 2 + 0.5 * (Math.random() - 0.5);
      batch.states.set(moved(facts, heading, place), body * size);
      this.#places.set(place, 3 * (first + body));
      this.#forwards.set([Math.cos(heading), Math.sin(heading), 0], 3 * (first + body));
    }
    batch.encode();
    return { batch, before: batch.states.slice(), onStep: () => undefined, first, step: 0, waited: share * facts.dt };
  }

  #superStep(group: Group): void {
    const { batch } = group;
    const size = this.facts.rest.length;
    const controlSize = this.#control.length;
    this.#sortIntoCells();
    group.before = batch.states.slice();
    const phase = (group.step * this.facts.policy!.phase_per_step!) % (2 * Math.PI);
    const limits = this.facts.policy!.command;
    for (let body = 0; body < batch.count; body++) {
      const state = group.before.subarray(body * size, (body + 1) * size);
      const pose = rootPose(this.facts.root!, state);
      const number = group.first + body;
      this.#places.set(pose.position, 3 * number);
      this.#forwards.set(pose.forward, 3 * number);
      const { force, pace } = this.guide?.wish(number, pose) ?? this.#ownWish(number, pose);
      const direction = this.#directionOf(number, pose, force);
      const speed = pace * limits[0]![3];
      const command = commandToward(pose, direction, speed);
      const bounded = command.map((value, i) => clamp(value, limits[i]![2], limits[i]![3]));
      // Tails should not beat in step.
      this.policy.controlInto(state, phase + 6 * this.#offsets[3 * number]!, bounded, this.#control);
      batch.controls.set(this.#control, body * controlSize);
    }
    batch.advance();
    group.step += 1;
    group.onStep();
  }

  #ownWish(number: number, { position }: RootPose): Wish {
    const force = this.target ? this.#toTarget(number, position) : this.#aroundCentre(number, position);
    return { force, pace: this.#paces[number]! };
  }

  // Wanted direction of a swimmer: along its wish, away from close neighbours, bed and surface.
  #directionOf(number: number, { position, forward }: RootPose, along: Vector): Vector {
    const away = this.#awayFromNeighbours(number, position);
    const force: Vector = [
      along[0] + SEPARATION * away[0],
      along[1] + SEPARATION * away[1],
      along[2] + SEPARATION * away[2],
    ];
    const margin = 1.5 * this.length;
    force[2] += Math.max(0, (this.room.low + margin - position[2]) / margin);
    force[2] -= Math.max(0, (position[2] - this.room.high + margin) / margin);
    const heading = Math.atan2(forward[1], forward[0]);
    let turn = Math.atan2(force[1], force[0]) - heading;
    turn -= 2 * Math.PI * Math.round(turn / (2 * Math.PI));
    const wanted = heading + clamp(turn, -MAX_TURN, MAX_TURN);
    const level = Math.max(Math.hypot(force[0], force[1]), 1e-6);
    const climb = clamp(force[2] / level, -Math.tan(MAX_CLIMB), Math.tan(MAX_CLIMB));
    return unit([Math.cos(wanted), Math.sin(wanted), climb]);
  }

  #toTarget(number: number, position: Vector): Vector {
    const spread = 0.5 * SPACING * this.length * Math.cbrt(this.count);
    const goal = this.target!.map((value, axis) => value + spread * this.#offsets[3 * number + axis]!);
    return unit([goal[0]! - position[0], goal[1]! - position[1], goal[2]! - position[2]]);
  }

  #aroundCentre(number: number, position: Vector): Vector {
    const x = position[0] - this.#centre[0];
    const y = position[1] - this.#centre[1];
    const distance = Math.max(Math.hypot(x, y), 1e-6);
    const inward = clamp((distance - this.#radii[number]!) / (0.3 * this.#radius), -0.8, 0.8);
    const depth = this.#centre[2] + this.#halfHeight * this.#offsets[3 * number + 2]!;
    return [(-y - inward * x) / distance, (x - inward * y) / distance, clamp((depth - position[2]) / this.#radius, -0.3, 0.3)];
  }

  #awayFromNeighbours(number: number, position: Vector): Vector {
    const reach = CLEARANCE * this.length;
    const sum: Vector = [0, 0, 0];
    for (let x = -1; x <= 1; x++) {
      for (let y = -1; y <= 1; y++) {
        for (let z = -1; z <= 1; z++) {
          const cell = this.#cells.get(this.#cellOf(position[0] + x * reach, position[1] + y * reach, position[2] + z * reach));
          for (const other of cell ?? []) {
            if (other !== number) {
              this.#addRepulsion(sum, position, other, reach);
            }
          }
        }
      }
    }
    return sum;
  }

  #addRepulsion(sum: Vector, position: Vector, other: number, reach: number): void {
    const x = position[0] - this.#places[3 * other]!;
    const y = position[1] - this.#places[3 * other + 1]!;
    const z = position[2] - this.#places[3 * other + 2]!;
    const distance = Math.max(Math.hypot(x, y, z), 1e-6);
    const strength = Math.max(1 - distance / reach, 0) / distance;
    sum[0] += strength * x;
    sum[1] += strength * y;
    sum[2] += strength * z;
  }

  #sortIntoCells(): void {
    this.#cells.clear();
    for (let number = 0; number < this.count; number++) {
      const key = this.#cellOf(this.#places[3 * number]!, this.#places[3 * number + 1]!, this.#places[3 * number + 2]!);
      const cell = this.#cells.get(key);
      if (cell) {
        cell.push(number);
      } else {
        this.#cells.set(key, [number]);
      }
    }
  }

  #cellOf(x: number, y: number, z: number): number {
    const side = CLEARANCE * this.length;
    const cell = (value: number): number => (Math.floor(value / side) + 4096) & 8191;
    return cell(x) * 8192 * 8192 + cell(y) * 8192 + cell(z);
  }
}

function triple(numbers: Float32Array, number: number): Vector {
  return [numbers[3 * number]!, numbers[3 * number + 1]!, numbers[3 * number + 2]!];
}

/** Return rest, turned about the vertical by `angle` [rad] and moved so that the body's root is at `place`. */
function moved(facts: Bundle, angle: number, place: Vector): Float32Array {
  const rest = Float32Array.from(facts.rest);
  const root = rootPose(facts.root!, rest).position;
  const turn = [Math.cos(angle / 2), 0, 0, Math.sin(angle / 2)];
  const state = rest.slice();
  if (facts.root!.kind === "free") {
    state.set(place, facts.root!.position);
    const { orientation } = facts.root!;
    state.set(multiply(turn, rest.subarray(orientation, orientation + 4)), orientation);
    return state;
  }
  for (const [position] of facts.rates.filter((_, i) => i % 3 === 0)) {
    const offset = [0, 1, 2].map((axis) => rest[position + axis]! - root[axis]!);
    const turned = rotate(turn, offset);
    state.set(turned.map((value, axis) => value + place[axis]!), position);
  }
  return state;
}
