// A push: the smallest change of a body's velocities that adds a wanted velocity to one of its points.

import { emptyPose, poseBones } from "../body/pose";
import { multiply, rotate } from "../body/quaternion";
import type { Bundle } from "../bundle/bundle";

/** Finite difference of positions in derivatives of a point [m or rad]. */
const PROBE = 1e-4;

/** Damping of singular directions, over the largest. */
const DAMPING = 1e-3;

/** Return the change of `state` (S), of its velocities alone, by which the point `offset` [m] of bone `bone` gains `change` [m/s]. */
export function push(
  facts: Bundle,
  state: Float32Array,
  bone: number,
  offset: ArrayLike<number>,
  change: ArrayLike<number>,
): Float32Array {
  const gained = new Float32Array(state.length);
  const { velocities, columns } = jacobian(facts, state, bone, offset);
  // Minimum-norm least squares: dv = Jᵀ (J Jᵀ)⁻¹ change.
  const gram = [0, 1, 2].map((row) => [0, 1, 2].map((column) => columns.reduce((sum, j) => sum + j[row]! * j[column]!, 0)));
  const largest = Math.max(gram[0]![0]!, gram[1]![1]!, gram[2]![2]!, 1e-12);
  for (let axis = 0; axis < 3; axis++) {
    gram[axis]![axis]! += DAMPING * largest;
  }
  const weights = solve3(gram, change);
  velocities.forEach((entry, i) => {
    const column = columns[i]!;
    gained[entry] = column[0]! * weights[0]! + column[1]! * weights[1]! + column[2]! * weights[2]!;
  });
  return gained;
}

/** Return the change of `state` (S) by which the origin of bone `bone` gets nearer to the velocity `wanted` [m/s], by at most `most` [m/s]. */
export function pullTo(facts: Bundle, state: Float32Array, bone: number, wanted: ArrayLike<number>, most: number): Float32Array {
  const { velocities, columns } = jacobian(facts, state, bone, [0, 0, 0]);
  const now = [0, 1, 2].map((axis) => velocities.reduce((sum, entry, i) => sum + columns[i]![axis]! * state[entry]!, 0));
  const change = now.map((value, axis) => wanted[axis]! - value);
  return push(facts, state, bone, [0, 0, 0], bounded(change, most));
}

/** Return a vector, shortened to a length of at most `most`. */
export function bounded(vector: readonly number[], most: number): number[] {
  const length = Math.hypot(...vector);
  return length > most ? vector.map((value) => (value * most) / length) : [...vector];
}

interface Jacobian {
  /** State entries that are velocities. */
  readonly velocities: number[];
  /** Derivatives of the point by each of them. */
  readonly columns: number[][];
}

function jacobian(facts: Bundle, state: Float32Array, bone: number, offset: ArrayLike<number>): Jacobian {
  const probe = Float64Array.from(state);
  const pose = emptyPose(facts.skeleton.length);
  const pointNow = (): number[] => {
    poseBones(facts.skeleton, probe, pose);
    const turned = rotate(pose.orientations.subarray(4 * bone, 4 * bone + 4), offset);
    return [0, 1, 2].map((axis) => pose.positions[3 * bone + axis]! + turned[axis]!);
  };
  const before = pointNow();
  const velocities: number[] = [];
  const columns: number[][] = [];
  const take = (velocity: number): void => {
    const after = pointNow();
    velocities.push(velocity);
    columns.push(after.map((coordinate, axis) => (coordinate - before[axis]!) / PROBE));
  };
  for (const [position, velocity] of facts.rates) {
    const kept = probe[position]!;
    probe[position] = kept + PROBE;
    take(velocity);
    probe[position] = kept;
  }
  for (const [orientation, angularVelocity] of facts.orientations) {
    const kept = probe.slice(orientation, orientation + 4);
    for (let axis = 0; axis < 3; axis++) {
      const turn = [1, 0, 0, 0];
      turn[1 + axis] = PROBE / 2;
      probe.set(multiply(kept, turn), orientation);
      take(angularVelocity + axis);
    }
    probe.set(kept, orientation);
  }
  return { velocities, columns };
}

/** Solve a symmetric system of three by Cramer's rule. */
function solve3(m: number[][], b: ArrayLike<number>): number[] {
  const determinant = det(m[0]!, m[1]!, m[2]!);
  return [0, 1, 2].map((column) => {
    const replaced = m.map((row, i) => row.map((value, j) => (j === column ? b[i]! : value)));
    return det(replaced[0]!, replaced[1]!, replaced[2]!) / determinant;
  });
}

function det(a: number[], b: number[], c: number[]): number {
  return (
    a[0]! * (b[1]! * c[2]! - b[2]! * c[1]!) -
    a[1]! * (b[0]! * c[2]! - b[2]! * c[0]!) +
    a[2]! * (b[0]! * c[1]! - b[1]! * c[0]!)
  );
}
