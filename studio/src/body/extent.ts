// Position and size of a body, from its pose alone.

import type { Bone } from "../bundle/bundle";
import { isMoved, type Pose } from "./pose";

/** Middle, lowest and highest point of a body [m], by its bones. */
export interface Extent {
  readonly middle: [number, number, number];
  readonly low: number;
  readonly high: number;
}

/** Return the numbers of the moving bones. */
export function movingBones(skeleton: readonly Bone[]): number[] {
  return skeleton.map((_, number) => number).filter((number) => isMoved(skeleton, number));
}

/** Return the reach of a bone's shapes, or of a model's skin that follows it, from its origin [m]. */
export function reachOf(bone: Bone): number {
  const reaches = bone.shapes.map((shape) => {
    const largest = shape.kind === "capsule" ? shape.size[0]! + shape.size[1]! : Math.max(...shape.size);
    return Math.hypot(...shape.position) + largest;
  });
  return Math.max(bone.reach ?? 0, ...reaches);
}

/** Return the drawn ones among `bones`; all of them if a skin is drawn around mass points. */
function drawnOf(skeleton: readonly Bone[], bones: readonly number[]): readonly number[] {
  const drawn = bones.filter((number) => reachOf(skeleton[number]!) > 0);
  return drawn.length > 0 ? drawn : bones;
}

/** Return the box around `bones`, each with its shapes. */
export function extentOf(skeleton: readonly Bone[], bones: readonly number[], pose: Pose): Extent {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (const number of drawnOf(skeleton, bones)) {
    const reach = reachOf(skeleton[number]!);
    for (let axis = 0; axis < 3; axis++) {
      const at = pose.positions[3 * number + axis]!;
      low[axis] = Math.min(low[axis]!, at - reach);
      high[axis] = Math.max(high[axis]!, at + reach);
    }
  }
  return {
    middle: [(low[0]! + high[0]!) / 2, (low[1]! + high[1]!) / 2, (low[2]! + high[2]!) / 2],
    low: low[2]!,
    high: high[2]!,
  };
}

/** Return the longest side of the box around the bones [m]. */
export function sizeOfBody(skeleton: readonly Bone[], bones: readonly number[], pose: Pose): number {
  let size = 1e-3;
  const drawn = drawnOf(skeleton, bones);
  for (let axis = 0; axis < 3; axis++) {
    let low = Infinity;
    let high = -Infinity;
    for (const number of drawn) {
      const reach = reachOf(skeleton[number]!);
      low = Math.min(low, pose.positions[3 * number + axis]! - reach);
      high = Math.max(high, pose.positions[3 * number + axis]! + reach);
    }
    size = Math.max(size, high - low);
  }
  return size;
}
