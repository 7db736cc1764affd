// The drawn walkers: the same shapes or skin as the body on show, each with colours of its own.

import { BufferAttribute, BufferGeometry, Group, type Object3D } from "three";
import { movingBones } from "../body/extent";
import { emptyPose, poseBones } from "../body/pose";
import { isMeshSkin, type Bundle, type MeshSkin, type Shape } from "../bundle/bundle";
import { ShapeInstances } from "./body/instances";
import { softMaterial } from "./body/materials";
import { shapeColour } from "./body/shapes";
import { makeSkin, partColour, partColours, skinGeometry } from "./body/skin";
import type { Patch } from "./glsl";

export interface WalkersView {
  readonly object: Object3D;
  /** Show walker `number` in `state` (S). */
  show(number: number, state: Float32Array): void;
  dispose(): void;
}

/** Return `count` bodies of a bundle. */
export function makeWalkersView(facts: Bundle, count: number, patches: readonly Patch[]): WalkersView {
  return isMeshSkin(facts.skin) ? skinnedWalkers(facts, facts.skin, count, patches) : shapedWalkers(facts, count, patches);
}

/** Return the difference of hue of walker `number` from the body on show. */
function hueOf(number: number, count: number): number {
  return (number + 1) / (count + 1);
}

/** Share of all triangles above which a part of a skin is a garment, not a detail. */
const GARMENT = 0.15;

function skinnedWalkers(facts: Bundle, skin: MeshSkin, count: number, patches: readonly Patch[]): WalkersView {
  const object = new Group();
  object.name = "walkers";
  const geometry = skinGeometry(skin);
  const material = softMaterial(patches);
  const views = Array.from({ length: count }, (_, number) => {
    const own = dressed(geometry, skin, hueOf(number, count));
    const view = makeSkin(own, material, facts);
    object.add(view.object);
    return { own, view };
  });
  const pose = emptyPose(facts.skeleton.length);
  return {
    object,
    show(number, state) {
      poseBones(facts.skeleton, state, pose);
      views[number]!.view.update(pose);
    },
    dispose() {
      views.forEach(({ own }) => own.dispose());
      geometry.dispose();
      material.dispose();
    },
  };
}

/** Return a skin whose garments have other hues; its largest part is the body itself. */
function dressed(geometry: BufferGeometry, skin: MeshSkin, hue: number): BufferGeometry {
  const sizes = skin.parts.map((part) => part.triangles);
  const largest = sizes.indexOf(Math.max(...sizes));
  const least = GARMENT * sizes.reduce((sum, size) => sum + size, 0);
  const colours = skin.parts.map((part, number) => {
    const colour = partColour(part);
    return number !== largest && part.triangles > least ? colour.offsetHSL(hue, 0, 0) : colour;
  });
  const own = new BufferGeometry().setIndex(geometry.index);
  Object.entries(geometry.attributes).forEach(([name, attribute]) => own.setAttribute(name, attribute));
  const size = geometry.getAttribute("position").array.length;
  own.setAttribute("color", new BufferAttribute(partColours(skin, geometry.index!.array, size, colours), 3));
  return own;
}

function shapedWalkers(facts: Bundle, count: number, patches: readonly Patch[]): WalkersView {
  const bones = facts.skeleton;
  const shapes = new ShapeInstances(bones, movingBones(bones), count, patches);
  const object = new Group();
  object.name = "walkers";
  object.add(...shapes.meshes);
  const skin = commonestColour(bones.flatMap((bone) => bone.shapes));
  for (let number = 0; number < count; number++) {
    shapes.paint(number, (shape) => {
      const colour = shapeColour(shape);
      return colour.getHex() === skin ? colour : colour.offsetHSL(hueOf(number, count), 0, 0);
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

/** Return the colour of most shapes, which all bodies keep. */
function commonestColour(shapes: readonly Shape[]): number | undefined {
  const counts = new Map<number, number>();
  for (const shape of shapes) {
    const colour = shapeColour(shape).getHex();
    counts.set(colour, (counts.get(colour) ?? 0) + 1);
  }
  const [commonest] = [...counts].sort(([, one], [, other]) => other - one);
  return commonest?.[0];
}
