// Whether a swimmer has reached its target, back up: as in studio/descents.py, for pages without a server.

import { DEGREES } from "../body/heading";
import { rootPose } from "../body/root";
import type { Root } from "../bundle/bundle";
import type { Judged } from "./facts";

/** Whether a motion of the physics has reached the goal. */
export interface Verdict {
  readonly isSuccess: boolean;
  /** Final distance. */
  readonly gap: number;
  /** The verdict in one line. */
  readonly words: string;
}

/** Return whether `states` (rows * S) of the physics end at `place` (x, y, z) [m]. */
export function judgeSwimming(root: Root, judged: Judged, place: readonly number[], states: Float32Array, size: number): Verdict {
  const poses = Array.from({ length: states.length / size }, (_, row) => rootPose(root, states.subarray(row * size, (row + 1) * size)));
  const rolls = poses.map((pose) => Math.abs(pose.roll));
  const { position } = poses.at(-1)!;
  const gap = Math.hypot(...position.map((number, axis) => number - place[axis]!));
  const isUpright = Math.max(...rolls.slice(-1 - judged.last)) < judged.roll;
  const rolled = (DEGREES * Math.max(...rolls)).toFixed(0);
  const lengths = (gap / judged.length).toFixed(2);
  return {
    isSuccess: gap < judged.within && isUpright,
    gap,
    words: `ends ${gap.toFixed(2)} m (${lengths} body lengths) from the target, rolled by ${rolled}° at most`,
  };
}
