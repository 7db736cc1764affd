// Walkers as they are drawn: the same shapes as the body on show, each body in shades of its own.

import { Color, Group, type Object3D } from "three";
import { movingBones } from "../body/extent";
import { emptyPose, poseBones } from "../body/pose";
import type { Bundle } from "../bundle/bundle";
import { ShapeInstances } from "./body/instances";
import type { Patch } from "./glsl";

/** Saturation and lightness of the tints. */
const SATURATION = 0.5;
const LIGHTNESS = 0.72;

export interface WalkersView {
  readonly object: Object3D;
  /** Show walker `number` in `state` (S). */
  show(number: number, state: Float32Array): void;
  dispose(): void;
}

/** Return `count` bodies of a bundle. */
export function makeWalkersView(facts: Bundle, count: number, patches: readonly Patch[]): WalkersView {
  const bones = facts.skeleton;
  const shapes = new ShapeInstances(bones, movingBones(bones), count, patches);
  const object = new Group();
  object.name = "walkers";
  object.add(...shapes.meshes);
  for (let number = 0; number < count; number++) {
    shapes.tint(number, new Color().setHSL(number / count, SATURATION, LIGHTNESS));
  }
  const pose = emptyPose(bones.length);
  return {
    object,
    show(number, state) {
      poseBones(bones, state, pose);
      shapes.show(number, pose);
    },
    dispose: () => shapes.dispose(),
  };
}
