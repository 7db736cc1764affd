// A school as it is drawn: one mesh a group, every swimmer bent by matrices from a texture.

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
  type Material,
  Group as Object3DGroup,
  type Object3D,
} from "three";
import { MATRIX_SIZE, SwimmerBones } from "../body/skinning";
import type { Bundle } from "../bundle/bundle";
import type { Group, School } from "../steering/school";
import { skinMaterial } from "./body/materials";
import { skinGeometry } from "./body/skin";
import type { Patch } from "./glsl";

export interface SchoolView {
  readonly object: Object3D;
  /** Draw every swimmer where it is between its super steps. */
  update(): void;
  dispose(): void;
}

interface GroupView {
  readonly mesh: Mesh;
  update(): void;
  dispose(): void;
}

export function makeSchoolView(facts: Bundle, school: School, size: number, patches: readonly Patch[]): SchoolView {
  const object = new Object3DGroup();
  object.name = "school";
  const skin = skinGeometry(facts.skin!);
  const bones = new SwimmerBones(facts.skeleton, facts.rest);
  const scales = facts.system === "fish" ? 1 : 0;
  const views = school.groups.map((group) =>
    makeGroupView(facts, group, skin, bones, (instances) => skinMaterial(size, scales, [instances, ...patches])),
  );
  object.add(...views.map((view) => view.mesh));
  return {
    object,
    update: () => views.forEach((view) => view.update()),
    dispose() {
      views.forEach((view) => view.dispose());
      skin.dispose();
    },
  };
}

function makeGroupView(
  facts: Bundle,
  group: Group,
  skin: BufferGeometry,
  bones: SwimmerBones,
  material: (instances: Patch) => Material,
): GroupView {
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
  const geometry = new InstancedBufferGeometry();
  geometry.index = skin.index;
  Object.entries(skin.attributes).forEach(([name, attribute]) => geometry.setAttribute(name, attribute));
  const numbers = Float32Array.from({ length: count }, (_, i) => i);
  const tints = Float32Array.from({ length: count }, () => 0.8 + 0.4 * Math.random());
  geometry.setAttribute("body", new InstancedBufferAttribute(numbers, 1));
  geometry.setAttribute("tint", new InstancedBufferAttribute(tints, 1));
  geometry.instanceCount = count;
  const made = material(instancePatch(before, after, share));
  const mesh = new Mesh(geometry, made);
  mesh.frustumCulled = false;
  mesh.receiveShadow = true;
  return {
    mesh,
    update: () => void (share.value = group.waited / facts.dt),
    dispose() {
      before.dispose();
      after.dispose();
      geometry.dispose();
      made.dispose();
    },
  };
}

/** Three points of a texture a bone: the rows of its matrix. */
function matrixTexture(bones: number, count: number): DataTexture {
  const numbers = new Float32Array(count * bones * MATRIX_SIZE);
  const texture = new DataTexture(numbers, 3 * bones, count, RGBAFormat, FloatType);
  texture.minFilter = NearestFilter;
  texture.magFilter = NearestFilter;
  return texture;
}

/** Bends a skin by the matrices of its own body, between those of two super steps. */
function instancePatch(before: DataTexture, after: DataTexture, share: IUniform<number>): Patch {
  return {
    key: "school",
    uniforms: { bonesBefore: { value: before }, bonesAfter: { value: after }, stepShare: share },
    shared: "varying float vTint;",
    attributes: `
      attribute float body;
      attribute float tint;
      attribute vec4 skinIndex;
      attribute vec4 skinWeight;
      uniform highp sampler2D bonesBefore;
      uniform highp sampler2D bonesAfter;
      uniform float stepShare;
      vec4 boneRow(int bone, int row) {
        ivec2 at = ivec2(3 * bone + row, int(body + 0.5));
        return mix(texelFetch(bonesBefore, at, 0), texelFetch(bonesAfter, at, 0), stepShare);
      }
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
