// The bones of many swimmers are those of one, and at rest the skin stays where it is.

import { expect, test } from "vitest";
import { emptyPose, poseBones } from "../src/body/pose";
import { rotate } from "../src/body/quaternion";
import { MATRIX_SIZE, SwimmerBones } from "../src/body/skinning";
import type { Bone } from "../src/bundle/bundle";
import fish from "./vectors/fish.json";

const skeleton = fish.skeleton as unknown as Bone[];
const [rest, state] = [fish.between[0]!, fish.between[2]!];

function apply(matrix: Float32Array, point: number[]): number[] {
  return [0, 1, 2].map((row) => {
    const [a, b, c, d] = matrix.subarray(4 * row, 4 * row + 4);
    return a! * point[0]! + b! * point[1]! + c! * point[2]! + d!;
  });
}

test("a skin in the state it was bound in does not move", () => {
  const bones = new SwimmerBones(skeleton, rest);
  const out = new Float32Array(MATRIX_SIZE * bones.count);
  bones.write(rest, out, 0);
  const point = [0.1, -0.2, 0.3];
  for (let bone = 0; bone < bones.count; bone++) {
    const moved = apply(out.subarray(MATRIX_SIZE * bone, MATRIX_SIZE * (bone + 1)), point);
    moved.forEach((value, axis) => expect(value).toBeCloseTo(point[axis]!, 5));
  }
});

test("a point fixed to a bone goes where the bone's pose takes it", () => {
  const bones = new SwimmerBones(skeleton, rest);
  const out = new Float32Array(MATRIX_SIZE * bones.count);
  bones.write(state, out, 0);
  const before = emptyPose(skeleton.length);
  const after = emptyPose(skeleton.length);
  poseBones(skeleton, rest, before);
  poseBones(skeleton, state, after);
  const offset = [0.02, -0.01, 0.03];
  for (let bone = 0; bone < bones.count; bone++) {
    const place = (pose: typeof before): number[] => {
      const turned = rotate(pose.orientations.subarray(4 * bone, 4 * bone + 4), offset);
      return turned.map((value, axis) => value + pose.positions[3 * bone + axis]!);
    };
    const moved = apply(out.subarray(MATRIX_SIZE * bone, MATRIX_SIZE * (bone + 1)), place(before));
    moved.forEach((value, axis) => expect(value).toBeCloseTo(place(after)[axis]!, 4));
  }
});
