// Walkers as they are drawn: the same shapes as the body on show, each body dressed in colours of its own.

import { Group, type Object3D } from "three";
import { movingBones } from "../body/extent";
import { emptyPose, poseBones } from "../body/pose";
import type { Bundle, Shape } from "../bundle/bundle";
import { ShapeInstances } from "./body/instances";
import { shapeColour } from "./body/shapes";
import type { Patch } from "./glsl";

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
  const skin = commonestColour(bones.flatMap((bone) => bone.shapes));
  for (let number = 0; number < count; number++) {
    const hue = (number + 1) / (count + 1);
    shapes.paint(number, (shape) => {
      const colour = shapeColour(shape);
      return colour.getHex() === skin ? colour : colour.offsetHSL(hue, 0, 0);
    });
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

/** Return the colour that most shapes have: all bodies have it. */
function commonestColour(shapes: readonly Shape[]): number | undefined {
  const counts = new Map<number, number>();
  for (const shape of shapes) {
    const colour = shapeColour(shape).getHex();
    counts.set(colour, (counts.get(colour) ?? 0) + 1);
  }
  const [commonest] = [...counts].sort(([, one], [, other]) => other - one);
  return commonest?.[0];
}
