// Position and direction of the whole body, read from its state (state/pose.py, policies/steering.py).

import type { Root, Weights } from "../bundle/bundle";
import { rotate } from "./quaternion";

export type Vector = [number, number, number];

export interface RootPose {
  /** Position [m]. */
  readonly position: Vector;
  /** Velocity [m/s]. */
  readonly velocity: Vector;
  /** Unit vector forward. */
  readonly forward: Vector;
  /** Unit vector to the left. */
  readonly left: Vector;
  /** Unit vector upward, perpendicular to forward. */
  readonly up: Vector;
  /** Roll to the right [rad]. */
  readonly roll: number;
}

/** Return the pose of the whole body in `state` (S). */
export function rootPose(root: Root, state: ArrayLike<number>): RootPose {
  if (root.kind === "free") {
    const quaternion = [0, 1, 2, 3].map((i) => state[root.orientation + i]!);
    return posed(
      at(state, root.position),
      at(state, root.velocity),
      rotate(quaternion, [1, 0, 0]) as Vector,
      rotate(quaternion, [0, 0, 1]) as Vector,
    );
  }
  return posed(
    weighted(root.position, state),
    weighted(root.velocity, state),
    unit(weighted(root.forward, state)),
    unit(weighted(root.up, state)),
  );
}

function posed(position: Vector, velocity: Vector, forward: Vector, upward: Vector): RootPose {
  const left = unit(cross(upward, forward));
  const up = cross(forward, left);
  return { position, velocity, forward, left, up, roll: Math.atan2(left[2], up[2]) };
}

/** Return the command [speed, turn, climb, roll] that leads from `pose` along the unit vector `direction` at `speed` [m/s]. */
export function commandToward(pose: RootPose, direction: Vector, speed: number): number[] {
  const ahead = dot(direction, pose.forward);
  const aside = dot(direction, pose.left);
  const above = dot(direction, pose.up);
  const climb = Math.atan2(above, Math.hypot(ahead, aside));
  return [speed, Math.atan2(aside, ahead), climb, -pose.roll];
}

export function dot(a: Vector, b: Vector): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

export function cross(a: Vector, b: Vector): Vector {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

export function unit(vector: Vector): Vector {
  const length = Math.max(Math.hypot(...vector), 1e-9);
  return [vector[0] / length, vector[1] / length, vector[2] / length];
}

function at(state: ArrayLike<number>, entry: number): Vector {
  return [state[entry]!, state[entry + 1]!, state[entry + 2]!];
}

function weighted(weights: Weights, state: ArrayLike<number>): Vector {
  const sum: Vector = [0, 0, 0];
  for (const [entry, weight] of weights) {
    for (let axis = 0; axis < 3; axis++) {
      sum[axis]! += weight * state[entry + axis]!;
    }
  }
  return sum;
}
