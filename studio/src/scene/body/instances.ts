// The shapes of many bodies of a kind: one draw call for each shape, for any number of bodies.

import { InstancedMesh, Matrix4, Vector3, type Color } from "three";
import type { Pose } from "../../body/pose";
import type { Bone, Shape } from "../../bundle/bundle";
import { toQuaternion } from "../axes";
import type { Patch } from "../glsl";
import { shapeMaterial } from "./materials";
import { shapeColour, shapeGeometry } from "./shapes";
import { boneMatrix } from "./skin";

interface InstancedShape {
  readonly mesh: InstancedMesh<ReturnType<typeof shapeGeometry>, ReturnType<typeof shapeMaterial>>;
  readonly bone: number;
  readonly shape: Shape;
  /** Transform from the shape to its bone. */
  readonly own: Matrix4;
}

export class ShapeInstances {
  readonly #shapes: InstancedShape[];
  readonly #matrix = new Matrix4();

  /** The shapes of some bones of a skeleton, for `count` bodies. */
  constructor(skeleton: readonly Bone[], bones: readonly number[], count: number, patches: readonly Patch[]) {
    this.#shapes = bones.flatMap((bone) => skeleton[bone]!.shapes.map((shape) => makeInstances(shape, bone, count, patches)));
  }

  get meshes(): InstancedMesh[] {
    return this.#shapes.map(({ mesh }) => mesh);
  }

  /** Show body `number` in a pose, moved along the ground by `x` and `y` [m]. */
  show(number: number, pose: Pose, x = 0, y = 0): void {
    for (const { mesh, bone, own } of this.#shapes) {
      const matrix = boneMatrix(pose, bone, this.#matrix).multiply(own);
      matrix.elements[12] += x;
      matrix.elements[13] += y;
      mesh.setMatrixAt(number, matrix);
      mesh.instanceMatrix.needsUpdate = true;
    }
  }

  /** Give body `number` its own colours; either all bodies have them or none. */
  paint(number: number, colourOf: (shape: Shape) => Color): void {
    for (const { mesh, shape } of this.#shapes) {
      // The colour of an instance is multiplied by that of the material.
      mesh.material.color.set(0xffffff);
      mesh.setColorAt(number, colourOf(shape));
    }
  }

  dispose(): void {
    for (const { mesh } of this.#shapes) {
      mesh.geometry.dispose();
      mesh.material.dispose();
      mesh.dispose();
    }
  }
}

function makeInstances(shape: Shape, bone: number, count: number, patches: readonly Patch[]): InstancedShape {
  const mesh = new InstancedMesh(shapeGeometry(shape), shapeMaterial(shapeColour(shape), shape.colour[3], patches), count);
  mesh.frustumCulled = false;
  mesh.castShadow = true;
  mesh.receiveShadow = true;
  const own = new Matrix4().compose(new Vector3(...shape.position), toQuaternion(shape.orientation), new Vector3(1, 1, 1));
  return { mesh, bone, shape, own };
}
