// The skin of a body: one mesh that bends with the bones.

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
import { bytesOf, floatsOf, uint16Of, uint32Of } from "../../bundle/base64";
import { isMeshSkin, type Bundle, type MeshSkin, type SkinArrays } from "../../bundle/bundle";
import { skinPose, type Pose } from "../../body/pose";

/** Number of bones a point follows, as in glTF. */
export const INFLUENCES = 4;

/** Sum of a vertex's weights in the skin of a model. */
const WHOLE = 255;

/** Return the skin's triangles as it was made; `rest` attributes stay in the body's own frame, for its paint. */
export function skinGeometry(skin: SkinArrays | MeshSkin): BufferGeometry {
  return isMeshSkin(skin) ? meshGeometry(skin) : pointsGeometry(skin);
}

/** Triangles of a model's skin, each vertex in the colour of its part. */
function meshGeometry(skin: MeshSkin): BufferGeometry {
  const places = uint16Of(skin.vertices);
  const positions = Float32Array.from(places, (place, i) => skin.lowest[i % 3]! + skin.step * place);
  const indices = uint16Of(skin.triangles);
  const bones = Uint16Array.from(bytesOf(skin.influences), (place) => skin.bones[place]!.number);
  const weights = Float32Array.from(bytesOf(skin.weights), (weight) => weight / WHOLE);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("color", new BufferAttribute(partColours(skin, indices, positions.length), 3));
  geometry.setAttribute("skinIndex", new BufferAttribute(bones, INFLUENCES));
  geometry.setAttribute("skinWeight", new BufferAttribute(weights, INFLUENCES));
  geometry.setIndex(new BufferAttribute(indices, 1));
  geometry.computeVertexNormals();
  return geometry;
}

/** Return the linear colour of every vertex of a model's skin, by its parts' colours, or others in their order. */
export function partColours(skin: MeshSkin, indices: ArrayLike<number>, size: number, colours = skin.parts.map(partColour)): Float32Array<ArrayBuffer> {
  const light = new Float32Array(size);
  let first = 0;
  skin.parts.forEach((part, number) => {
    const end = first + 3 * part.triangles;
    for (; first < end; first++) {
      colours[number]!.toArray(light, 3 * indices[first]!);
    }
  });
  return light;
}

/** Return the colour of a part of a model's skin. */
export function partColour({ colour }: MeshSkin["parts"][number]): Color {
  return new Color().setRGB(...colour, SRGBColorSpace);
}

/** The triangles of the skin of mass points at rest. */
function pointsGeometry(skin: SkinArrays): BufferGeometry {
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

/** Parts of a skin, numbered for shaders. */
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

/** Linear colours from sRGB, as bundles hold them. */
export function linear(colours: Float32Array<ArrayBuffer>): Float32Array<ArrayBuffer> {
  const colour = new Color();
  for (let i = 0; i < colours.length; i += 3) {
    colour.setRGB(colours[i]!, colours[i + 1]!, colours[i + 2]!, SRGBColorSpace);
    colour.toArray(colours, i);
  }
  return colours;
}

/** Return the transforms from the skin, as it was made, to the frame of each bone. */
function inverseSkinPoses({ skeleton, skin }: Bundle): Matrix4[] {
  const pose = skinPose(skeleton, skin);
  return skeleton.map((_, i) => boneMatrix(pose, i, new Matrix4()).invert());
}

const position = new Vector3();
const orientation = new Quaternion();
const unitScale = new Vector3(1, 1, 1);

/** Write the pose of bone `number` to `matrix`. */
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
export function makeSkin(geometry: BufferGeometry, material: Material, facts: Bundle): SkinView {
  const mesh = new SkinnedMesh(geometry, material);
  const drawnBones = facts.skeleton.map(() => {
    const bone = new Bone();
    bone.matrixAutoUpdate = false;
    bone.matrixWorldAutoUpdate = false;
    return bone;
  });
  const skeleton = new Skeleton(drawnBones, inverseSkinPoses(facts));
  // Bones are given in the mesh's own axes, so the positions of the mesh and its parent do not count.
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
