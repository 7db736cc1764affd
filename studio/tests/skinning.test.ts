// The bones of many swimmers are those of one, and a skin goes where its bones go from where it was made.

import { expect, test } from "vitest";
import { emptyPose, poseBones, skinPose } from "../src/body/pose";
import { rotate } from "../src/body/quaternion";
import { MATRIX_SIZE, SwimmerBones } from "../src/body/skinning";
import type { Bone, Bundle } from "../src/bundle/bundle";
import { shippedFile } from "./shipped";
import fish from "./vectors/fish.json";

const skeleton = fish.skeleton as unknown as Bone[];
const state = fish.between[2]!;

function apply(matrix: Float32Array, point: number[]): number[] {
  return [0, 1, 2].map((row) => {
    const [a, b, c, d] = matrix.subarray(4 * row, 4 * row + 4);
    return a! * point[0]! + b! * point[1]! + c! * point[2]! + d!;
  });
}

test("the skin of a dolphin that rests under water is there, and as it was made", async () => {
  const { skeleton, rest } = JSON.parse(new TextDecoder().decode(await shippedFile("dolphin-50/bundle.json"))) as Bundle;
  const bones = new SwimmerBones(skeleton);
  const out = new Float32Array(MATRIX_SIZE * bones.count);
  bones.write(rest, out, 0);
  const point = [0.1, -0.2, 0.3];
  const depth = rest[2]! - skeleton[0]!.offset[2];
  expect(depth).toBeLessThan(-1);
  const place = [point[0]!, point[1]!, point[2]! + depth];
  for (let bone = 0; bone < bones.count; bone++) {
    const moved = apply(out.subarray(MATRIX_SIZE * bone, MATRIX_SIZE * (bone + 1)), point);
    moved.forEach((value, axis) => expect(value).toBeCloseTo(place[axis]!, 5));
  }
});

test("a point fixed to a bone goes where the bone's pose takes it", () => {
  const bones = new SwimmerBones(skeleton);
  const out = new Float32Array(MATRIX_SIZE * bones.count);
  bones.write(state, out, 0);
  const before = skinPose(skeleton);
  const after = emptyPose(skeleton.length);
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
