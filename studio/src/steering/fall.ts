// A walker that has lost its balance falls and gets up, as recorded on the physics: its emulator knows neither.

import { multiply, rotate } from "../body/quaternion";
import { rootPose } from "../body/root";
import { floatsOf } from "../bundle/base64";
import type { Bundle, Root } from "../bundle/bundle";
import { interpolateHermite, type StateStructure } from "../motion/interpolate";

/** Mean score of the last super steps from which the emulator is lost, and their number. */
const LOST = 3;
const WINDOW = 3;

/** Height of the root over the initial one below which a body has fallen, and tilt [rad] from which it cannot be held. */
const FALLEN = 0.6;
const TILT = 0.9;

/** Time at the start of a recorded fall in which the pose at hand is looked for [s]. */
const UNTIL_TILTED = 0.6;

/** Time in which the body passes over from its own pose to the recorded one [s]. */
const PASSING = 0.4;

type FreeRoot = Extract<Root, { kind: "free" }>;

/** A recorded fall that is going on. */
interface Fall {
  readonly states: Float32Array;
  /** Left turn from the recorded headings to the body's [rad], and shift along the ground [m]. */
  readonly turn: number;
  readonly shift: readonly [number, number];
  /** What the body's pose was off by at first. */
  readonly offset: Float32Array;
  readonly from: number;
  time: number;
}

export class Falls {
  readonly #root: FreeRoot;
  readonly #recorded: Float32Array[];
  readonly #structure: StateStructure;
  readonly #size: number;
  readonly #scores: number[] = [];
  #fall: Fall | null = null;

  constructor(private readonly facts: Bundle) {
    if (facts.root?.kind !== "free") {
      throw new Error("walkers have a free root");
    }
    this.#root = facts.root;
    this.#size = facts.rest.length;
    this.#structure = { rates: facts.rates, orientations: facts.orientations };
    this.#recorded = (facts.falls?.motions ?? []).map(floatsOf);
  }

  /** Whether the body is falling or getting up. */
  get isFalling(): boolean {
    return this.#fall !== null;
  }

  /** Return the state (S) of a body that has lost its balance, instead of the emulator's `next`, scored `score`; null while it walks. */
  instead(state: Float32Array, next: Float32Array, score: number): Float32Array | null {
    if (!this.#fall) {
      this.#scores.push(score);
      this.#scores.splice(0, this.#scores.length - WINDOW);
      if (!this.#isLost(next)) {
        return null;
      }
      this.#scores.length = 0;
      if (this.#recorded.length === 0) {
        return standingAt(this.facts, this.#root, state);
      }
      this.#fall = this.#begin(state);
    }
    return this.#advanced(this.#fall);
  }

  #isLost(next: Float32Array): boolean {
    const isFar = this.#scores.length === WINDOW && this.#scores.reduce((sum, one) => sum + one, 0) > WINDOW * LOST;
    if (isFar || !next.every(Number.isFinite)) {
      return true;
    }
    const isLow = next[this.#root.position + 2]! < FALLEN * this.facts.default_motion.start[this.#root.position + 2]!;
    return isLow || tiltOf(this.#root, next) > TILT;
  }

  // Of the recorded falls the one in the direction in which the body moves, from the pose that is tilted as much as it.
  #begin(state: Float32Array): Fall {
    const root = this.#root;
    const moving = courseOf(root, state);
    const alike = this.#recorded.map((states) => Math.cos(courseOf(root, states) - moving));
    const states = this.#recorded[alike.indexOf(Math.max(...alike))]!;
    const tilt = tiltOf(root, state);
    let from = 0;
    let least = Infinity;
    for (let row = 0; row * this.facts.falls!.dt < UNTIL_TILTED; row++) {
      const off = Math.abs(tiltOf(root, states.subarray(row * this.#size)) - tilt);
      if (off < least) {
        least = off;
        from = row;
      }
    }
    const first = states.slice(from * this.#size, (from + 1) * this.#size);
    const turn = headingOf(root, state) - headingOf(root, first);
    const turned = this.#moved(first, turn, [0, 0]);
    const shift = [0, 1].map((axis) => state[root.position + axis]! - turned[root.position + axis]!) as [number, number];
    const offset = Float32Array.from(state, (number, i) => number - this.#moved(first, turn, shift)[i]!);
    this.#aimQuaternion(state, offset, this.#moved(first, turn, shift));
    return { states, turn, shift, offset, from: from * this.facts.falls!.dt, time: 0 };
  }

  #advanced(fall: Fall): Float32Array {
    const { dt } = this.facts.falls!;
    fall.time += this.facts.dt;
    const rows = fall.states.length / this.#size;
    const position = Math.min((fall.from + fall.time) / dt, rows - 1);
    const row = Math.min(Math.floor(position), rows - 2);
    const [one, other] = [row, row + 1].map((at) => fall.states.subarray(at * this.#size, (at + 1) * this.#size));
    const recorded = new Float32Array(this.#size);
    interpolateHermite(one!, other!, position - row, dt, this.#structure, recorded);
    const state = this.#moved(recorded, fall.turn, fall.shift);
    const left = Math.max(1 - fall.time / PASSING, 0);
    const share = left * left * (3 - 2 * left);
    fall.offset.forEach((number, i) => (state[i]! += share * number));
    const { orientation } = this.#root;
    const length = Math.hypot(...state.subarray(orientation, orientation + 4));
    for (let i = orientation; i < orientation + 4; i++) {
      state[i]! /= length;
    }
    if (position >= rows - 1) {
      this.#fall = null;
    }
    return state;
  }

  // The two signs of a quaternion are one rotation: the nearer one is passed over from. The clock needs no passing over.
  #aimQuaternion(state: Float32Array, offset: Float32Array, first: Float32Array): void {
    const { orientation } = this.#root;
    const entries = [0, 1, 2, 3].map((i) => orientation + i);
    const agreement = entries.reduce((sum, i) => sum + state[i]! * first[i]!, 0);
    entries.forEach((i) => (offset[i] = Math.sign(agreement) * state[i]! - first[i]!));
    const clock = this.facts.rates.map(([position]) => position).filter((position) => Math.abs(offset[position]!) > Math.PI / 2);
    clock.forEach((position) => (offset[position] = 0));
    offset[this.facts.falls!.heading] = 0;
  }

  #moved(recorded: ArrayLike<number>, turn: number, shift: readonly [number, number]): Float32Array {
    const moved = turnedBy(this.#root, recorded, turn);
    moved[this.#root.position]! += shift[0];
    moved[this.#root.position + 1]! += shift[1];
    moved[this.facts.falls!.heading]! += turn;
    return moved;
  }
}

/** Return a state (S) turned to the left about the world's vertical by `angle` [rad]. */
export function turnedBy(root: FreeRoot, state: ArrayLike<number>, angle: number): Float32Array {
  const turn = [Math.cos(angle / 2), 0, 0, Math.sin(angle / 2)];
  const turned = Float32Array.from(state);
  turned.set(rotate(turn, turned.slice(root.position, root.position + 3)), root.position);
  turned.set(multiply(turn, turned.slice(root.orientation, root.orientation + 4)), root.orientation);
  turned.set(rotate(turn, turned.slice(root.velocity, root.velocity + 3)), root.velocity);
  return turned;
}

/** Return the initial state where a body is, headed as it is: for bodies without recorded falls. */
function standingAt(facts: Bundle, root: FreeRoot, state: Float32Array): Float32Array {
  const { start } = facts.default_motion;
  const standing = turnedBy(root, start, headingOf(root, state) - headingOf(root, start));
  standing.set(state.subarray(root.position, root.position + 2), root.position);
  return standing;
}

function headingOf(root: FreeRoot, state: ArrayLike<number>): number {
  const { forward } = rootPose(root, state);
  return Math.atan2(forward[1], forward[0]);
}

/** Return the direction in which a body moves, from straight ahead to the left [rad]. */
function courseOf(root: FreeRoot, state: ArrayLike<number>): number {
  const { velocity } = rootPose(root, state);
  return Math.atan2(velocity[1], velocity[0]) - headingOf(root, state);
}

function tiltOf(root: FreeRoot, state: ArrayLike<number>): number {
  return Math.acos(Math.min(Math.max(rootPose(root, state).up[2], -1), 1));
}
