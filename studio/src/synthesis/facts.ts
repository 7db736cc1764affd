// What a bundle says of a descent: its sizes, what may be moved, where to begin, how to go on.

/** Something that may be dragged, turned or weighed before a descent. */
export interface Movable {
  readonly name: string;
  /** `place`: (x, y, z) [m] in the world. `heading`: an angle about Z [rad]. `number`: one number, such as a weight. */
  readonly kind: "place" | "heading" | "number";
  readonly unit: string;
  /** What it is at first. */
  readonly value: readonly number[];
  readonly low: readonly number[];
  readonly high: readonly number[];
  /** Numbers of the module that follow it: each is a component of the value, plus an offset. */
  readonly at: readonly (readonly [entry: number, component: number, offset: number])[];
}

/** How Levenberg and Marquardt's method goes on: what the descent in Python does, too. */
export interface Settings {
  readonly iterations: number;
  /** Relative fall of J below which a descent ends. */
  readonly converged: number;
  /** The damping to begin with, a share of the mean curvature. */
  readonly first_damping: number;
  /** So many times the last good damping are tried side by side. */
  readonly dampings: readonly number[];
  readonly min_damping: number;
  readonly max_damping: number;
}

/** When a swimmer's motion is a success (studio/descents.py): near the target, and back up over the last period. */
export interface Judged {
  /** Of the body [m]. */
  readonly length: number;
  /** How near counts as there [m]. */
  readonly within: number;
  /** How far it may be rolled [rad], over so many super steps before the end. */
  readonly roll: number;
  readonly last: number;
}

export interface DescentFacts {
  readonly name: string;
  readonly about: string;
  readonly system: string;
  /** File of the module, beside `bundle.json`. */
  readonly wasm: string;
  /** Of a super step [s]. */
  readonly dt: number;
  /** Super steps of a motion. */
  readonly steps: number;
  /** Numbers of a state, a latent state, a control, of what is varied, of a defect, and of the objective. */
  readonly state: number;
  readonly latent: number;
  readonly control: number;
  readonly z: number;
  readonly defect: number;
  readonly numbers: number;
  readonly start: readonly number[];
  readonly guesses: readonly (readonly number[])[];
  readonly movable: readonly Movable[];
  readonly settings: Settings;
  /** What a page without a server judges by; null where only the server can. */
  readonly judged: Judged | null;
}

/** Where what may be moved was moved to, by name; what is not named is where it was at first. */
export type Values = Readonly<Record<string, readonly number[]>>;
