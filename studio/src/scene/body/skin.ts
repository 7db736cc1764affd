// The skin of a body of mass points: one mesh that bends with the bones.

import {
  Bone,
  BufferAttribute,
  BufferGeometry,
  DetachedBindMode,
  Matrix4,
  Object3D,
  Quaternion,
  Skeleton,
  SkinnedMesh,
  SRGBColorSpace,
  Vector3,
  Color,
  type Material,
} from "three";
import { floatsOf, uint16Of, uint32Of } from "../../bundle/base64";
import type { Bone as BoneFacts, SkinArrays } from "../../bundle/bundle";
import { skinPose, type Pose } from "../../body/pose";

/** Bones a point follows, as glTF has them. */
export const INFLUENCES = 4;

/** Return the skin's triangles at rest; `rest` attributes stay in the body's own place and paint it. */
export function skinGeometry(skin: SkinArrays): BufferGeometry {
  const positions = floatsOf(skin.positions);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("rest", new BufferAttribute(positions, 3));
  geometry.setAttribute("normal", new BufferAttribute(floatsOf(skin.normals), 3));
  geometry.setAttribute("color", new BufferAttribute(linear(floatsOf(skin.colours)), 3));
  if (skin.uvs !== undefined) {
    geometry.setAttribute("uv", new BufferAttribute(floatsOf(skin.uvs), 2));
  }
  geometry.setAttribute("skinIndex", new BufferAttribute(uint16Of(skin.bones), INFLUENCES));
  geometry.setAttribute("skinWeight", new BufferAttribute(floatsOf(skin.weights), INFLUENCES));
  const indices = uint32Of(skin.indices);
  geometry.setIndex(new BufferAttribute(indices, 1));
  geometry.setAttribute("part", new BufferAttribute(partNumbers(skin, indices, positions.length / 3), 1));
  return geometry;
}

/** Parts of a skin as numbers that shaders read. */
const PARTS = ["body", "fin", "eye"];

/** Return for every point which of `PARTS` it belongs to. */
function partNumbers(skin: SkinArrays, indices: Uint32Array, points: number): Float32Array {
  const numbers = new Float32Array(points);
  for (const [name, first, count] of skin.parts ?? []) {
    const number = Math.max(PARTS.indexOf(name), 0);
    for (let i = first; i < first + count; i++) {
      numbers[indices[i]!] = number;
    }
  }
  return numbers;
}

/** Colours stand in bundles as sRGB and are drawn as linear light. */
function linear(colours: Float32Array<ArrayBuffer>): Float32Array<ArrayBuffer> {
  const colour = new Color();
  for (let i = 0; i < colours.length; i += 3) {
    colour.setRGB(colours[i]!, colours[i + 1]!, colours[i + 2]!, SRGBColorSpace);
    colour.toArray(colours, i);
  }
  return colours;
}

/** Return, bone by bone, what takes a point of the skin as it was made into the bone's frame. */
function inverseSkinPoses(bones: readonly BoneFacts[]): Matrix4[] {
  const pose = skinPose(bones);
  return bones.map((_, i) => boneMatrix(pose, i, new Matrix4()).invert());
}

const position = new Vector3();
const orientation = new Quaternion();
const unitScale = new Vector3(1, 1, 1);

/** Write where bone `number` is to `matrix`. */
export function boneMatrix(pose: Pose, number: number, matrix: Matrix4): Matrix4 {
  const [p, q] = [3 * number, 4 * number];
  position.set(pose.positions[p]!, pose.positions[p + 1]!, pose.positions[p + 2]!);
  orientation.set(
    pose.orientations[q + 1]!,
    pose.orientations[q + 2]!,
    pose.orientations[q + 3]!,
    pose.orientations[q]!,
  );
  return matrix.compose(position, orientation, unitScale);
}

export interface SkinView {
  readonly object: Object3D;
  update(pose: Pose): void;
}

/** Return a skin that follows poses; its mesh hangs in physics' axes. */
export function makeSkin(
  geometry: BufferGeometry,
  material: Material,
  bones: readonly BoneFacts[],
): SkinView {
  const mesh = new SkinnedMesh(geometry, material);
  const drawnBones = bones.map(() => {
    const bone = new Bone();
    bone.matrixAutoUpdate = false;
    bone.matrixWorldAutoUpdate = false;
    return bone;
  });
  const skeleton = new Skeleton(drawnBones, inverseSkinPoses(bones));
  // Bones are given in the mesh's own axes, so neither the mesh's place nor its parent's counts.
  mesh.bindMode = DetachedBindMode;
  mesh.bind(skeleton, new Matrix4());
  mesh.frustumCulled = false;
  mesh.castShadow = true;
  mesh.receiveShadow = true;
  return {
    object: mesh,
    update(pose) {
      drawnBones.forEach((bone, i) => boneMatrix(pose, i, bone.matrixWorld));
    },
  };
}
