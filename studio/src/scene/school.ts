// The drawn school: one mesh per group, every swimmer bent by matrices from a texture.

import {
  DataTexture,
  FloatType,
  InstancedBufferAttribute,
  InstancedBufferGeometry,
  Mesh,
  NearestFilter,
  RGBAFormat,
  type BufferGeometry,
  type IUniform,
  Group as Object3DGroup,
  type Object3D,
} from "three";
import { MATRIX_SIZE, SwimmerBones } from "../body/skinning";
import type { Bundle } from "../bundle/bundle";
import type { Group, School } from "../steering/school";
import { skinMaterial } from "./body/materials";
import { skinGeometry } from "./body/skin";
import type { Patch } from "./glsl";
import { makeSchoolShadows, type ShadowGround } from "./school_shadows";

export interface SchoolView {
  readonly object: Object3D;
  /** Draw every swimmer, interpolated between its super steps. */
  update(): void;
  dispose(): void;
}

interface GroupView {
  readonly meshes: readonly Mesh[];
  update(): void;
  dispose(): void;
}

/** The shared parts of all groups of a school. */
interface Kind {
  readonly facts: Bundle;
  readonly skin: BufferGeometry;
  readonly bones: SwimmerBones;
  readonly ground: ShadowGround;
  /** Patches of every material of the scene. */
  readonly patches: readonly Patch[];
}

/** Return the swimmers of a school, drawn at `scale`, and their shadows on the ground. */
export function makeSchoolView(
  facts: Bundle,
  school: School,
  shadowGround: ShadowGround,
  patches: readonly Patch[],
  scale = 1,
): SchoolView {
  const object = new Object3DGroup();
  object.name = "school";
  object.scale.setScalar(scale);
  const ground = scaledGround(shadowGround, scale);
  const skin = skinGeometry(facts.skin!);
  const bones = new SwimmerBones(facts.skeleton);
  const kind = { facts, skin, bones, ground, patches };
  const views = school.groups.map((group) => makeGroupView(kind, group));
  object.add(...views.flatMap((view) => view.meshes));
  return {
    object,
    update: () => views.forEach((view) => view.update()),
    dispose() {
      views.forEach((view) => view.dispose());
      skin.dispose();
    },
  };
}

/** The ground in the coordinates of a school drawn at `scale`. */
function scaledGround({ height, sun, size }: ShadowGround, scale: number): ShadowGround {
  const scaled = {
    get value() {
      return height.value / scale;
    },
  };
  return { height: scaled as IUniform<number>, sun, size };
}

function makeGroupView({ facts, skin, bones, ground, patches }: Kind, group: Group): GroupView {
  const { count } = group.batch;
  const stateSize = facts.rest.length;
  const before = matrixTexture(bones.count, count);
  const after = matrixTexture(bones.count, count);
  const share: IUniform<number> = { value: 0 };
  const write = (texture: DataTexture, states: Float32Array): void => {
    const numbers = texture.image.data as unknown as Float32Array;
    for (let body = 0; body < count; body++) {
      const state = states.subarray(body * stateSize, (body + 1) * stateSize);
      bones.write(state, numbers, body * bones.count * MATRIX_SIZE);
    }
    texture.needsUpdate = true;
  };
  const refresh = (): void => {
    write(before, group.before);
    write(after, group.batch.states);
  };
  refresh();
  group.onStep = refresh;
  const bonesOf = bonesPatch(before, after, share);
  const scales = facts.system === "fish" ? 1 : 0;
  const material = skinMaterial(ground.size, scales, [bonesOf, bendPatch(), ...patches]);
  const mesh = new Mesh(instancesOf(skin, count), material);
  mesh.frustumCulled = false;
  mesh.receiveShadow = true;
  const shadows = makeSchoolShadows(facts, skin, count, bonesOf, ground, patches);
  return {
    meshes: [mesh, shadows],
    update: () => void (share.value = group.waited / facts.dt),
    dispose() {
      before.dispose();
      after.dispose();
      for (const one of [mesh, shadows]) {
        one.geometry.dispose();
        one.material.dispose();
      }
    },
  };
}

/** `count` instances of the skin, each with its own number and shade. */
function instancesOf(skin: BufferGeometry, count: number): InstancedBufferGeometry {
  const geometry = new InstancedBufferGeometry();
  geometry.index = skin.index;
  Object.entries(skin.attributes).forEach(([name, attribute]) => geometry.setAttribute(name, attribute));
  const numbers = Float32Array.from({ length: count }, (_, i) => i);
  const tints = Float32Array.from({ length: count }, () => 0.8 + 0.4 * Math.random());
  geometry.setAttribute("body", new InstancedBufferAttribute(numbers, 1));
  geometry.setAttribute("tint", new InstancedBufferAttribute(tints, 1));
  geometry.instanceCount = count;
  return geometry;
}

/** Three texels per bone: the rows of its matrix. */
function matrixTexture(bones: number, count: number): DataTexture {
  const numbers = new Float32Array(count * bones * MATRIX_SIZE);
  const texture = new DataTexture(numbers, 3 * bones, count, RGBAFormat, FloatType);
  texture.minFilter = NearestFilter;
  texture.magFilter = NearestFilter;
  return texture;
}

/** A row of a bone's matrix of the drawn body, between two super steps. */
const BONE_ROWS = `
  attribute float body;
  uniform highp sampler2D bonesBefore;
  uniform highp sampler2D bonesAfter;
  uniform float stepShare;
  vec4 boneRow(int bone, int row) {
    ivec2 at = ivec2(3 * bone + row, int(body + 0.5));
    return mix(texelFetch(bonesBefore, at, 0), texelFetch(bonesAfter, at, 0), stepShare);
  }`;

/** The bones of the drawn body, for a shader. */
function bonesPatch(before: DataTexture, after: DataTexture, share: IUniform<number>): Patch {
  return {
    key: "schoolBones",
    uniforms: { bonesBefore: { value: before }, bonesAfter: { value: after }, stepShare: share },
    attributes: BONE_ROWS,
  };
}

/** Bends a skin by the matrices of its own body. */
function bendPatch(): Patch {
  return {
    key: "school",
    uniforms: {},
    shared: "varying float vTint;",
    attributes: `
      attribute float tint;
      attribute vec4 skinIndex;
      attribute vec4 skinWeight;
      vec4 bentRow(int row) {
        return skinWeight.x * boneRow(int(skinIndex.x), row) + skinWeight.y * boneRow(int(skinIndex.y), row)
          + skinWeight.z * boneRow(int(skinIndex.z), row) + skinWeight.w * boneRow(int(skinIndex.w), row);
      }`,
    normal: `
      vec4 bent0 = bentRow(0);
      vec4 bent1 = bentRow(1);
      vec4 bent2 = bentRow(2);
      objectNormal = normalize(vec3(dot(bent0.xyz, objectNormal), dot(bent1.xyz, objectNormal), dot(bent2.xyz, objectNormal)));`,
    vertex: `
      vec4 unbent = vec4(transformed, 1.0);
      transformed = vec3(dot(bent0, unbent), dot(bent1, unbent), dot(bent2, unbent));
      vTint = tint;`,
    colour: "diffuseColor.rgb *= vTint;",
  };
}
