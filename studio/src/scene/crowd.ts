// A crowd of soft bodies as it is drawn: all cloths in one draw call, and one for each thing that strikes them.

import { Color, Group, InstancedMesh, Matrix4, Vector3, type Object3D } from "three";
import { emptyPose, poseBones } from "../body/pose";
import type { Bundle, Shape } from "../bundle/bundle";
import type { Crowd } from "../steering/crowd";
import { toQuaternion } from "./axes";
import { clothKind, surfaceColour } from "./body/body";
import { makeCloth } from "./body/cloth";
import { fittingsMaterial, shapeMaterial, surfaceMaterial } from "./body/materials";
import { shapeColour, shapeGeometry } from "./body/shapes";
import { boneMatrix } from "./body/skin";
import type { Patch } from "./glsl";

/** Distance of neighbours in a crowd, over the body's size. */
const SPACING = 2.1;

/** How far the colours of cloths are apart: in hue, of a whole circle, and in lightness. */
const HUES = 0.09;
const LIGHTNESS = 0.12;

export interface CrowdView {
  readonly object: Object3D;
  /** How far from the middle the outermost stand [m]. */
  readonly radius: number;
  /** Show body `number` in `state` (S). */
  show(number: number, state: Float32Array): void;
  dispose(): void;
}

/** Return the bodies of a crowd, in rows around a place that is left free for the one on show. */
export function makeCrowdView(facts: Bundle, crowd: Crowd, size: number, patches: readonly Patch[]): CrowdView {
  const base = surfaceColour(facts.surface!);
  // The colour of each is that of its instance.
  const kind = clothKind(facts, size);
  const cloth = makeCloth(kind, crowd.count, {
    surface: (nodes) => surfaceMaterial(kind.surface, new Color(1, 1, 1), size, [nodes, ...patches]),
    fittings: fittingsMaterial(patches),
  });
  // Over so wide a place shadows are coarse: on the ground they will do.
  cloth.surfaces.receiveShadow = false;
  const shapes = facts.skeleton.flatMap((bone, number) => bone.shapes.map((shape) => makeStrikers(shape, number, crowd.count, patches)));
  const object = new Group();
  object.name = "crowd";
  object.add(cloth.object, ...shapes.map((one) => one.mesh));
  const places = placesAround(crowd.count).map(([x, y]) => [SPACING * size * x, SPACING * size * y, 0] as const);
  places.forEach((_, number) => cloth.surfaces.setColorAt(number, shade(base, number)));
  const pose = emptyPose(facts.skeleton.length);
  const matrix = new Matrix4();
  return {
    object,
    radius: Math.max(...places.map(([x, y]) => Math.hypot(x, y))),
    show(number, state) {
      const [x, y] = places[number]!;
      poseBones(facts.skeleton, state, pose);
      cloth.show(number, state, pose, places[number]!);
      for (const { mesh, bone, own } of shapes) {
        boneMatrix(pose, bone, matrix).multiply(own);
        matrix.elements[12] += x;
        matrix.elements[13] += y;
        mesh.setMatrixAt(number, matrix);
        mesh.instanceMatrix.needsUpdate = true;
      }
    },
    dispose() {
      cloth.dispose();
      for (const { mesh } of shapes) {
        mesh.geometry.dispose();
        mesh.material.dispose();
        mesh.dispose();
      }
    },
  };
}

interface Strikers {
  readonly mesh: InstancedMesh<ReturnType<typeof shapeGeometry>, ReturnType<typeof shapeMaterial>>;
  readonly bone: number;
  /** From the shape into its bone. */
  readonly own: Matrix4;
}

/** Return a shape of a bone so many times over. */
function makeStrikers(shape: Shape, bone: number, count: number, patches: readonly Patch[]): Strikers {
  const mesh = new InstancedMesh(shapeGeometry(shape), shapeMaterial(shapeColour(shape), shape.colour[3], patches), count);
  mesh.frustumCulled = false;
  mesh.castShadow = true;
  mesh.receiveShadow = true;
  const own = new Matrix4().compose(new Vector3(...shape.position), toQuaternion(shape.orientation), new Vector3(1, 1, 1));
  return { mesh, bone, own };
}

/** Return the `count` places of a grid that are nearest to its middle, the middle left out. */
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

/** Return a colour like `base`, another for every number. */
function shade(base: Color, number: number): Color {
  const hue = ((number * 0.618034) % 1) - 0.5;
  const lightness = ((number * 0.754878) % 1) - 0.5;
  return base.clone().offsetHSL(HUES * hue, 0, LIGHTNESS * lightness);
}
