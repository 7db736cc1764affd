// The drawn crowd of soft bodies: all cloths in one draw call, and one for each collider.

import { Color, Group, type Object3D } from "three";
import { emptyPose, poseBones } from "../body/pose";
import type { Bundle } from "../bundle/bundle";
import type { Crowd } from "../steering/crowd";
import { clothKind, surfaceColour } from "./body/body";
import { makeCloth } from "./body/cloth";
import { ShapeInstances } from "./body/instances";
import { fittingsMaterial, surfaceMaterial } from "./body/materials";
import type { Patch } from "./glsl";

/** Distance of neighbours in a crowd, over the body's size. */
const SPACING = 2.1;

/** Spread of the colours of cloths: in hue, as a share of the circle, and in lightness. */
const HUES = 0.09;
const LIGHTNESS = 0.12;

export interface CrowdView {
  readonly object: Object3D;
  /** Distance of the outermost bodies from the middle [m]. */
  readonly radius: number;
  /** Show body `number` in `state` (S). */
  show(number: number, state: Float32Array): void;
  dispose(): void;
}

/** Return the bodies of a crowd, in rows around a place left free for the one on show. */
export function makeCrowdView(facts: Bundle, crowd: Crowd, size: number, patches: readonly Patch[]): CrowdView {
  const base = surfaceColour(facts.surface!);
  // The colour of each is that of its instance.
  const kind = clothKind(facts, size);
  const cloth = makeCloth(kind, crowd.count, {
    surface: (nodes) => surfaceMaterial(kind.surface, new Color(1, 1, 1), size, [nodes, ...patches]),
    fittings: fittingsMaterial(patches),
  });
  // Over so wide an area shadows are coarse, and only good enough on the ground.
  cloth.surfaces.receiveShadow = false;
  const strikers = new ShapeInstances(facts.skeleton, [...facts.skeleton.keys()], crowd.count, patches);
  const object = new Group();
  object.name = "crowd";
  object.add(cloth.object, ...strikers.meshes);
  const places = placesAround(crowd.count).map(([x, y]) => [SPACING * size * x, SPACING * size * y, 0] as const);
  places.forEach((_, number) => cloth.surfaces.setColorAt(number, shade(base, number)));
  const pose = emptyPose(facts.skeleton.length);
  return {
    object,
    radius: Math.max(...places.map(([x, y]) => Math.hypot(x, y))),
    show(number, state) {
      const [x, y] = places[number]!;
      poseBones(facts.skeleton, state, pose);
      cloth.show(number, state, pose, places[number]!);
      strikers.show(number, pose, x, y);
    },
    dispose() {
      cloth.dispose();
      strikers.dispose();
    },
  };
}

/** Return the `count` places of a grid nearest to its middle, without the middle. */
function placesAround(count: number): [number, number][] {
  const reach = Math.ceil(Math.sqrt(count + 1) / 2);
  const places: [number, number][] = [];
  for (let x = -reach; x <= reach; x++) {
    for (let y = -reach; y <= reach; y++) {
      if (x !== 0 || y !== 0) {
        places.push([x, y]);
      }
    }
  }
  places.sort(([ax, ay], [bx, by]) => Math.max(Math.abs(ax), Math.abs(ay)) - Math.max(Math.abs(bx), Math.abs(by)));
  return places.slice(0, count);
}

/** Return a colour like `base`, different for every number. */
function shade(base: Color, number: number): Color {
  const hue = ((number * 0.618034) % 1) - 0.5;
  const lightness = ((number * 0.754878) % 1) - 0.5;
  return base.clone().offsetHSL(HUES * hue, 0, LIGHTNESS * lightness);
}
