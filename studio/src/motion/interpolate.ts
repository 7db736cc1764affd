// States between super steps: Hermite's cubics through the known velocities (animation/interpolate.py).

import type { Pairs } from "../bundle/bundle";
import { multiply } from "../body/quaternion";

/** Relations between a state's numbers. */
export interface StateStructure {
  /** (i, j): entry j is the time derivative of entry i. */
  readonly rates: Pairs;
  /** (i, j): a quaternion begins at i and its angular velocity, in the body's frame, at j. */
  readonly orientations: Pairs;
}

/** Write to `out` (S) the state at `share` (0..1) of the way from `before` to `after` (S), which lie `dt` [s] apart. */
export function interpolateHermite(
  before: ArrayLike<number>,
  after: ArrayLike<number>,
  share: number,
  dt: number,
  structure: StateStructure,
  out: Float32Array | Float64Array,
): void {
  for (let i = 0; i < out.length; i++) {
    out[i] = before[i]! * (1 - share) + after[i]! * share;
  }
  for (const [orientation, angularVelocity] of structure.orientations) {
    const p0 = quaternionAt(before, orientation);
    const p1 = withNearestSign(quaternionAt(after, orientation), p0);
    const v0 = slopeOf(p0, before, angularVelocity, dt);
    const v1 = slopeOf(p1, after, angularVelocity, dt);
    const quaternion = p0.map((_, i) => cubic(share, p0[i]!, p1[i]!, v0[i]!, v1[i]!));
    const length = Math.hypot(...quaternion);
    quaternion.forEach((component, i) => (out[orientation + i] = component / length));
  }
  for (const [position, velocity] of structure.rates) {
    const p0 = before[position]!;
    const p1 = after[position]!;
    const v0 = before[velocity]! * dt;
    const v1 = after[velocity]! * dt;
    out[position] = cubic(share, p0, p1, v0, v1);
    out[velocity] = cubicSlope(share, p0, p1, v0, v1) / dt;
  }
}

/** Hermite's cubic at share `s` of an interval, `p` at its ends with slopes `v` per interval. */
function cubic(s: number, p0: number, p1: number, v0: number, v1: number): number {
  const s2 = s * s;
  const s3 = s2 * s;
  return (2 * s3 - 3 * s2 + 1) * p0 + (s3 - 2 * s2 + s) * v0 + (3 * s2 - 2 * s3) * p1 + (s3 - s2) * v1;
}

/** The slope of `cubic` per interval. */
function cubicSlope(s: number, p0: number, p1: number, v0: number, v1: number): number {
  const s2 = s * s;
  return 6 * (s2 - s) * (p0 - p1) + (3 * s2 - 4 * s + 1) * v0 + (3 * s2 - 2 * s) * v1;
}

function quaternionAt(state: ArrayLike<number>, entry: number): number[] {
  return [state[entry]!, state[entry + 1]!, state[entry + 2]!, state[entry + 3]!];
}

function withNearestSign(quaternion: number[], other: number[]): number[] {
  const dot = quaternion.reduce((sum, component, i) => sum + component * other[i]!, 0);
  return dot < 0 ? quaternion.map((component) => -component) : quaternion;
}

/** Change of a quaternion over an interval: q̇ = ½ q ω. */
function slopeOf(quaternion: number[], state: ArrayLike<number>, entry: number, dt: number): number[] {
  const rotation = [0, state[entry]!, state[entry + 1]!, state[entry + 2]!];
  return multiply(quaternion, rotation).map((component) => (component * dt) / 2);
}
