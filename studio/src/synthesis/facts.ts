// The facts of a descent in a bundle: sizes, movable values, initial guesses and settings.

/** A value that can be dragged, turned or weighed before a descent. */
export interface Movable {
  readonly name: string;
  /** `place`: (x, y, z) [m] in the world. `heading`: an angle about Z [rad]. `number`: one number, such as a weight. */
  readonly kind: "place" | "heading" | "number";
  readonly unit: string;
  /** Initial value. */
  readonly value: readonly number[];
  readonly low: readonly number[];
  readonly high: readonly number[];
  /** Numbers of the module that follow it: each is a component of the value, plus an offset. */
  readonly at: readonly (readonly [entry: number, component: number, offset: number])[];
}

/** Settings of Levenberg and Marquardt's method, the same as in Python. */
export interface Settings {
  readonly iterations: number;
  /** Relative decrease of J below which a descent ends. */
  readonly converged: number;
  /** Initial damping, over the mean curvature. */
  readonly first_damping: number;
  /** Factors on the last good damping that are tried side by side. */
  readonly dampings: readonly number[];
  readonly min_damping: number;
  readonly max_damping: number;
}

/** When a swimmer's motion is a success (studio/descents.py): near the target, and back up over the last period. */
export interface Judged {
  /** Length of the body [m]. */
  readonly length: number;
  /** Tolerance of the distance [m]. */
  readonly within: number;
  /** Maximum roll [rad], over the `last` super steps. */
  readonly roll: number;
  readonly last: number;
}

export interface DescentFacts {
  readonly name: string;
  readonly about: string;
  readonly system: string;
  /** File of the module, beside `bundle.json`. */
  readonly wasm: string;
  /** Super step [s]. */
  readonly dt: number;
  /** Number of super steps of a motion. */
  readonly steps: number;
  /** Sizes of a state, a latent state, a control, the variables, a defect, and the objective's numbers. */
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
  /** Criteria for a page without a server; null if only the server can judge. */
  readonly judged: Judged | null;
}

/** Moved values by name; others keep their initial values. */
export type Values = Readonly<Record<string, readonly number[]>>;
