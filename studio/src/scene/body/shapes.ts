// The simple shapes of bones: capsules, boxes, spheres, ellipsoids and cylinders.

import {
  BufferGeometry,
  CapsuleGeometry,
  Color,
  CylinderGeometry,
  Mesh,
  SphereGeometry,
  SRGBColorSpace,
  type Material,
} from "three";
import { RoundedBoxGeometry } from "three/addons/geometries/RoundedBoxGeometry.js";
import type { Shape } from "../../bundle/bundle";
import { toQuaternion } from "../axes";

/** Radius of a box's edges, over its shortest half side, and its maximum [m]. */
const ROUNDING = 0.28;
const MAX_ROUNDING = 0.08;

/** Half height below which a flat shape is a marking on the ground, without round edges [m]. */
const FLAT = 0.02;

/** Return the shape's surface in the frame of the shape, Z along its axis. */
export function shapeGeometry(shape: Shape): BufferGeometry {
  const [a, b, c] = [shape.size[0] ?? 0, shape.size[1] ?? 0, shape.size[2] ?? 0];
  switch (shape.kind) {
    case "capsule":
      return new CapsuleGeometry(a, 2 * b, 12, 28).rotateX(Math.PI / 2);
    case "cylinder":
      return new CylinderGeometry(a, a, 2 * b, 48).rotateX(Math.PI / 2);
    case "sphere":
      return new SphereGeometry(a, 36, 24);
    case "ellipsoid":
      return new SphereGeometry(1, 36, 24).scale(a, b, c);
    case "box":
      return boxGeometry(a, b, c);
  }
}

function boxGeometry(a: number, b: number, c: number): BufferGeometry {
  const shortest = Math.min(a, b, c);
  if (shortest < FLAT) {
    return new RoundedBoxGeometry(2 * a, 2 * b, 2 * c, 1, 1e-4);
  }
  const radius = Math.min(ROUNDING * shortest, MAX_ROUNDING);
  return new RoundedBoxGeometry(2 * a, 2 * b, 2 * c, 3, radius);
}

/** Return the shape's linear colour; bundles hold sRGB. */
export function shapeColour(shape: Shape): Color {
  const [red, green, blue] = shape.colour;
  return new Color().setRGB(red, green, blue, SRGBColorSpace);
}

/** Return a mesh of the shape in its bone's frame. */
export function shapeMesh(shape: Shape, material: Material): Mesh {
  const mesh = new Mesh(shapeGeometry(shape), material);
  mesh.position.fromArray(shape.position);
  mesh.quaternion.copy(toQuaternion(shape.orientation));
  mesh.castShadow = true;
  mesh.receiveShadow = true;
  return mesh;
}
