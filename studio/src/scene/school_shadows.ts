// Shadows of a school on the bed: a soft strip under every swimmer, bent with it. One draw call per group, without work for the
// processor: a shadow map for a whole school would be either coarse or slow.

import {
  BufferAttribute,
  Color,
  DoubleSide,
  InstancedBufferAttribute,
  InstancedBufferGeometry,
  Mesh,
  MeshBasicMaterial,
  type BufferGeometry,
  type IUniform,
  type Vector3,
} from "three";
import { emptyPose, poseBones } from "../body/pose";
import type { Bundle } from "../bundle/bundle";
import { toPhysics } from "./axes";
import { patchMaterial, type Patch } from "./glsl";
import { DUNES } from "./water/bed";

/** Number of sections of a strip from nose to tail. */
const SECTIONS = 7;

/** Darkness of a shadow right under a body, and height over which it fades, over the body's size. */
const DARKNESS = 0.5;
const FADE = 5;

/** Width of a shadow's soft edge, over the height of its caster. */
const PENUMBRA = 0.05;

/** Height of shadows over the sand, over the body's size. */
const LIFT = 0.012;

/** The ground on which shadows fall, and the light. */
export interface ShadowGround {
  /** Height of the bed [m], kept up to date by its owner. */
  readonly height: IUniform<number>;
  /** Direction of the sun, in three.js' axes. */
  readonly sun: Vector3;
  readonly size: number;
}

/** Return the shadows of `count` swimmers, whose bones `bending` reads (`boneRow` of school.ts). */
export function makeSchoolShadows(
  facts: Bundle,
  skin: BufferGeometry,
  count: number,
  bending: Patch,
  ground: ShadowGround,
  patches: readonly Patch[],
): Mesh<InstancedBufferGeometry, MeshBasicMaterial> {
  const geometry = stripGeometry(facts, skin, ground.sun);
  geometry.setAttribute("body", new InstancedBufferAttribute(Float32Array.from({ length: count }, (_, i) => i), 1));
  geometry.instanceCount = count;
  const material = new MeshBasicMaterial({ color: new Color(0.01, 0.03, 0.04), transparent: true, depthWrite: false, side: DoubleSide });
  const mesh = new Mesh(geometry, patchMaterial(material, [bending, castPatch(ground), ...patches]));
  mesh.frustumCulled = false;
  return mesh;
}

/** A strip along the body at rest: the middle of each section, the width of its shadow, and its bone. */
function stripGeometry(facts: Bundle, skin: BufferGeometry, sun: Vector3): InstancedBufferGeometry {
  const points = skin.getAttribute("position");
  const xs = Array.from({ length: points.count }, (_, i) => points.getX(i));
  const tail = xs.reduce((least, x) => Math.min(least, x), Infinity);
  const nose = xs.reduce((most, x) => Math.max(most, x), -Infinity);
  const slant = Math.hypot(sun.x, sun.z) / sun.y;
  const middles: number[] = [];
  const halves: number[] = [];
  const bones: number[] = [];
  const sides: number[] = [];
  for (let section = 0; section < SECTIONS; section++) {
    const x = tail + ((nose - tail) * section) / (SECTIONS - 1);
    const within = xs.map((_, i) => i).filter((i) => Math.abs(xs[i]! - x) < (0.6 * (nose - tail)) / (SECTIONS - 1));
    const heights = within.map((i) => points.getZ(i));
    const low = Math.min(...heights);
    const high = Math.max(...heights);
    const half = Math.max(...within.map((i) => Math.abs(points.getY(i)))) + (slant * (high - low)) / 4;
    for (const side of [-1, 1]) {
      middles.push(x, 0, (low + high) / 2);
      halves.push(half);
      bones.push(nearestBone(facts, x));
      sides.push(side);
    }
  }
  const indices = Array.from({ length: SECTIONS - 1 }, (_, i) => [0, 1, 2, 2, 1, 3].map((corner) => 2 * i + corner));
  const geometry = new InstancedBufferGeometry();
  geometry.setIndex(indices.flat());
  geometry.setAttribute("position", new BufferAttribute(Float32Array.from(middles), 3));
  geometry.setAttribute("halfWidth", new BufferAttribute(Float32Array.from(halves), 1));
  geometry.setAttribute("bone", new BufferAttribute(Float32Array.from(bones), 1));
  geometry.setAttribute("across", new BufferAttribute(Float32Array.from(sides), 1));
  const ends = sides.map((_, i) => (i < 2 || i >= 2 * SECTIONS - 2 ? 0 : 1));
  geometry.setAttribute("inside", new BufferAttribute(Float32Array.from(ends), 1));
  return geometry;
}

function nearestBone(facts: Bundle, x: number): number {
  const pose = emptyPose(facts.skeleton.length);
  poseBones(facts.skeleton, facts.rest, pose);
  const distances = facts.skeleton.map((_, bone) => Math.abs(pose.positions[3 * bone]! - x));
  return distances.indexOf(Math.min(...distances));
}

/** Projects a section along the light onto the sand. */
function castPatch(ground: ShadowGround): Patch {
  return {
    key: "schoolShadow",
    uniforms: {
      groundHeight: ground.height,
      bodySize: { value: ground.size },
      toSun: { value: toPhysics(ground.sun) },
    },
    shared: "varying float vAcross; varying float vSoft; varying float vDark;",
    attributes: `
      attribute float halfWidth;
      attribute float bone;
      attribute float across;
      attribute float inside;
      uniform float groundHeight;
      uniform float bodySize;
      uniform vec3 toSun;
      ${DUNES}`,
    vertex: `
      int number = int(bone + 0.5);
      vec4 row0 = boneRow(number, 0);
      vec4 row1 = boneRow(number, 1);
      vec4 row2 = boneRow(number, 2);
      vec4 middle = vec4(transformed, 1.0);
      vec3 place = vec3(dot(row0, middle), dot(row1, middle), dot(row2, middle));
      float rise = max(place.z - groundHeight, 0.0);
      float blur = ${PENUMBRA} * rise;
      vec2 aside = normalize(vec2(-row1.x, row0.x) + 1e-6);
      vec2 foot = place.xy - toSun.xy / toSun.z * rise + aside * across * (halfWidth + blur);
      float height = groundHeight + bodySize * (dunes(vec2(foot.x, -foot.y) / bodySize) + ${LIFT});
      transformed = vec3(foot, height);
      vAcross = across;
      vSoft = clamp(2.0 * blur / (halfWidth + blur), 0.15, 1.0);
      vDark = inside * ${DARKNESS} * exp(-rise / (${FADE.toFixed(1)} * bodySize));`,
    colour: "diffuseColor.a *= vDark * (1.0 - smoothstep(1.0 - vSoft, 1.0, abs(vAcross)));",
  };
}
