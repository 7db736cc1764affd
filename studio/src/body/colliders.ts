// Spheres and capsules that move with bones: they strike a cloth, and can be grabbed.

import type { Bone, Shape } from "../bundle/bundle";
import type { Pose } from "./pose";
import { rotate } from "./quaternion";

/** All points within a radius [m] of the line between two ends, in the frame of a bone; equal ends make a sphere. */
export interface Collider {
  readonly bone: number;
  readonly ends: readonly [number[], number[]];
  readonly radius: number;
}

/** Return the spheres and capsules of the bones; other shapes count as the sphere within them. */
export function collidersOf(skeleton: readonly Bone[]): Collider[] {
  return skeleton.flatMap((bone, number) => bone.shapes.map((shape) => colliderOf(shape, number)));
}

function colliderOf(shape: Shape, bone: number): Collider {
  const along = rotate(shape.orientation, [0, 0, shape.kind === "capsule" ? shape.size[1]! : 0]);
  const end = (sign: number): number[] => shape.position.map((value, axis) => value + sign * along[axis]!);
  const isRound = shape.kind === "capsule" || shape.kind === "sphere";
  return { bone, ends: [end(-1), end(1)], radius: isRound ? shape.size[0]! : Math.min(...shape.size) };
}

/** Return the ends of a collider in the world [m]. */
export function endsOf({ bone, ends }: Collider, pose: Pose): [number[], number[]] {
  const orientation = pose.orientations.subarray(4 * bone, 4 * bone + 4);
  const place = (end: number[]): number[] => rotate(orientation, end).map((value, axis) => value + pose.positions[3 * bone + axis]!);
  return [place(ends[0]), place(ends[1])];
}
