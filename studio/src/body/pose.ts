// Poses of the bones of a body in a state (appearance/skeleton.py, appearance/binding.py, state/links.py).

import { isMeshSkin, type Binding, type Bone, type Bundle, type Joint, type Weights } from "../bundle/bundle";
import { multiply, normalised, quaternionOfAxes, rotate } from "./quaternion";

/** Smallest length that a direction is divided by [m]. */
const MIN_LENGTH = 1e-12;

/** Positions (B, 3) [m] and orientations wxyz (B, 4) of bones in the world. */
export interface Pose {
  readonly positions: Float64Array;
  readonly orientations: Float64Array;
}

/** Return an empty pose of `bones` bones. */
export function emptyPose(bones: number): Pose {
  return { positions: new Float64Array(3 * bones), orientations: new Float64Array(4 * bones) };
}

/** Write the pose of all bones in `state` to `pose`. */
export function poseBones(skeleton: readonly Bone[], state: ArrayLike<number>, pose: Pose): void {
  skeleton.forEach((bone, number) => {
    let { position, orientation } = bone.binding ? boundPose(bone.binding, state) : jointedPose(bone, state);
    if (bone.parent >= 0) {
      const parent = orientationOf(pose, bone.parent);
      position = sum(positionOf(pose, bone.parent), rotate(parent, position));
      orientation = multiply(parent, orientation);
    }
    pose.positions.set(position, 3 * number);
    pose.orientations.set(orientation, 4 * number);
  });
}

/**
 * Return the pose in which a skin was made: a model's skin holds it; others are made around bones whose parent is the world.
 * The body at rest may be elsewhere, as the dolphin under water.
 */
export function skinPose(skeleton: readonly Bone[], skin: Bundle["skin"] = null): Pose {
  const pose = emptyPose(skeleton.length);
  skeleton.forEach(({ offset, orientation }, number) => {
    pose.positions.set(offset, 3 * number);
    pose.orientations.set(orientation, 4 * number);
  });
  if (isMeshSkin(skin)) {
    for (const { number, position, orientation } of skin.bones) {
      pose.positions.set(position, 3 * number);
      pose.orientations.set(orientation, 4 * number);
    }
  }
  return pose;
}

/** Return the position of bone `number` [m]. */
export function positionOf(pose: Pose, number: number): number[] {
  return Array.from(pose.positions.subarray(3 * number, 3 * number + 3));
}

/** Return the orientation of bone `number`. */
export function orientationOf(pose: Pose, number: number): number[] {
  return Array.from(pose.orientations.subarray(4 * number, 4 * number + 4));
}

/** Return whether anything moves a bone or one of its ancestors; a bone that nothing moves is scenery. */
export function isMoved(skeleton: readonly Bone[], number: number): boolean {
  for (let i = number; i >= 0; i = skeleton[i]!.parent) {
    const bone = skeleton[i]!;
    if (bone.joints.length > 0 || bone.binding) {
      return true;
    }
  }
  return false;
}

interface BonePose {
  position: number[];
  orientation: number[];
}

/** Pose of a bone in its parent's frame, joint after joint as in MuJoCo. */
function jointedPose(bone: Bone, state: ArrayLike<number>): BonePose {
  let position: number[] = [...bone.offset];
  let orientation: number[] = [...bone.orientation];
  for (const joint of bone.joints) {
    if (joint.kind === "free") {
      position = [state[joint.entry]!, state[joint.entry + 1]!, state[joint.entry + 2]!];
      orientation = quaternionAt(state, joint.entry + 3);
    } else if (joint.kind === "slide") {
      const distance = state[joint.entry]! - joint.reference;
      const along = joint.axis.map((component) => component * distance);
      position = sum(position, rotate(orientation, along));
    } else {
      const fixed = sum(position, rotate(orientation, joint.anchor));
      orientation = multiply(orientation, jointRotation(joint, state));
      position = difference(fixed, rotate(orientation, joint.anchor));
    }
  }
  return { position, orientation };
}

/** The quaternion of a ball joint, or of a hinge turned by its angle. */
function jointRotation(joint: Joint, state: ArrayLike<number>): number[] {
  if (joint.kind === "ball") {
    return quaternionAt(state, joint.entry);
  }
  const half = (state[joint.entry]! - joint.reference) / 2;
  const sine = Math.sin(half);
  return [Math.cos(half), sine * joint.axis[0], sine * joint.axis[1], sine * joint.axis[2]];
}

/** Pose of a bone that follows mass points: X along `forward`, Z along the part of `up` across it. */
function boundPose(binding: Binding, state: ArrayLike<number>): BonePose {
  const position = weightedSum(binding.position, state);
  if (binding.forward.length === 0) {
    return { position, orientation: [1, 0, 0, 0] };
  }
  const x = unit(weightedSum(binding.forward, state));
  const up = weightedSum(binding.up, state);
  const along = dot(up, x);
  const z = unit(up.map((component, i) => component - along * x[i]!));
  const y = cross(z, x);
  return { position, orientation: quaternionOfAxes(x, y, z) };
}

function weightedSum(weights: Weights, state: ArrayLike<number>): number[] {
  let x = 0;
  let y = 0;
  let z = 0;
  for (const [entry, weight] of weights) {
    x += weight * state[entry]!;
    y += weight * state[entry + 1]!;
    z += weight * state[entry + 2]!;
  }
  return [x, y, z];
}

function quaternionAt(state: ArrayLike<number>, entry: number): number[] {
  return normalised([state[entry]!, state[entry + 1]!, state[entry + 2]!, state[entry + 3]!]);
}

function sum(a: number[], b: number[]): number[] {
  return [a[0]! + b[0]!, a[1]! + b[1]!, a[2]! + b[2]!];
}

function difference(a: number[], b: number[]): number[] {
  return [a[0]! - b[0]!, a[1]! - b[1]!, a[2]! - b[2]!];
}

function dot(a: number[], b: number[]): number {
  return a[0]! * b[0]! + a[1]! * b[1]! + a[2]! * b[2]!;
}

function cross(a: number[], b: number[]): number[] {
  return [
    a[1]! * b[2]! - a[2]! * b[1]!,
    a[2]! * b[0]! - a[0]! * b[2]!,
    a[0]! * b[1]! - a[1]! * b[0]!,
  ];
}

function unit(vector: number[]): number[] {
  const length = Math.max(Math.hypot(...vector), MIN_LENGTH);
  return vector.map((component) => component / length);
}
