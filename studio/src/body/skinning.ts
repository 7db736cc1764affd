// Bones of many swimmers at once: matrices from the pose in which their skin was made to the current one, without new arrays.

import type { Bone, Weights } from "../bundle/bundle";
import { orientationOf, positionOf, skinPose, type Pose } from "./pose";
import { rotate } from "./quaternion";

/** Number of entries of a bone's matrix: three rows of four. */
export const MATRIX_SIZE = 12;

interface FlatWeights {
  readonly entries: Int32Array;
  readonly weights: Float64Array;
}

interface FlatBone {
  readonly position: FlatWeights;
  readonly forward: FlatWeights;
  readonly up: FlatWeights;
  /** Transform from the skin, as it was made, to the bone: rotation by rows, then the translation. */
  readonly inverse: Float64Array;
}

export class SwimmerBones {
  readonly count: number;
  readonly #bones: FlatBone[];
  readonly #frame = new Float64Array(MATRIX_SIZE);

  /** All bones must follow mass points. */
  constructor(skeleton: readonly Bone[]) {
    this.count = skeleton.length;
    const made = skinPose(skeleton);
    this.#bones = skeleton.map((bone, number) => {
      if (!bone.binding) {
        throw new Error(`bone '${bone.name}' follows no mass points`);
      }
      const flat = {
        position: flattened(bone.binding.position),
        forward: flattened(bone.binding.forward),
        up: flattened(bone.binding.up),
      };
      return { ...flat, inverse: inverseOf(made, number) };
    });
  }

  /** Write a matrix (3 rows of 4) a bone of a body in `state` (S) to `out`, from `first` on. */
  write(state: ArrayLike<number>, out: Float32Array, first: number): void {
    const frame = this.#frame;
    this.#bones.forEach((bone, number) => {
      writeFrame(bone, state, frame);
      const { inverse } = bone;
      const at = first + MATRIX_SIZE * number;
      for (let row = 0; row < 3; row++) {
        const a = frame[4 * row]!, b = frame[4 * row + 1]!, c = frame[4 * row + 2]!, d = frame[4 * row + 3]!;
        for (let column = 0; column < 4; column++) {
          const product = a * inverse[column]! + b * inverse[4 + column]! + c * inverse[8 + column]!;
          out[at + 4 * row + column] = column === 3 ? product + d : product;
        }
      }
    });
  }
}

function flattened(weights: Weights): FlatWeights {
  return {
    entries: Int32Array.from(weights, ([entry]) => entry),
    weights: Float64Array.from(weights, ([, weight]) => weight),
  };
}

type Frame = Pick<FlatBone, "position" | "forward" | "up">;

/** Write a bone's frame in the world: its axes as columns, its position as the last one (`boundPose` in pose.ts). */
function writeFrame(bone: Frame, state: ArrayLike<number>, out: Float64Array): void {
  let fx = weightedSum(bone.forward, state, 0);
  let fy = weightedSum(bone.forward, state, 1);
  let fz = weightedSum(bone.forward, state, 2);
  const forward = Math.hypot(fx, fy, fz) || 1;
  fx /= forward;
  fy /= forward;
  fz /= forward;
  let ux = weightedSum(bone.up, state, 0);
  let uy = weightedSum(bone.up, state, 1);
  let uz = weightedSum(bone.up, state, 2);
  const along = ux * fx + uy * fy + uz * fz;
  ux -= along * fx;
  uy -= along * fy;
  uz -= along * fz;
  const up = Math.hypot(ux, uy, uz) || 1;
  ux /= up;
  uy /= up;
  uz /= up;
  out[0] = fx;
  out[1] = uy * fz - uz * fy;
  out[2] = ux;
  out[3] = weightedSum(bone.position, state, 0);
  out[4] = fy;
  out[5] = uz * fx - ux * fz;
  out[6] = uy;
  out[7] = weightedSum(bone.position, state, 1);
  out[8] = fz;
  out[9] = ux * fy - uy * fx;
  out[10] = uz;
  out[11] = weightedSum(bone.position, state, 2);
}

function weightedSum({ entries, weights }: FlatWeights, state: ArrayLike<number>, axis: number): number {
  let sum = 0;
  for (let i = 0; i < entries.length; i++) {
    sum += weights[i]! * state[entries[i]! + axis]!;
  }
  return sum;
}

/** Return the transform from the world to the frame of bone `number` in `pose`. */
function inverseOf(pose: Pose, number: number): Float64Array {
  const position = positionOf(pose, number);
  const orientation = orientationOf(pose, number);
  const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => rotate(orientation, axis));
  const rows = axes.map((axis) => [...axis, -axis.reduce((sum, number, i) => sum + number * position[i]!, 0)]);
  return Float64Array.from(rows.flat());
}
