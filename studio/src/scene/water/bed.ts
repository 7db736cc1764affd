// The bed of the water: rippled sand, stones and sea grass, endless around the look-at point.

import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Group,
  Mesh,
  MeshStandardMaterial,
  Quaternion,
  Vector3,
  type IUniform,
  type Object3D,
} from "three";
import { detail, patchMaterial, type Patch } from "../glsl";
import { randomSource, type Random } from "../random";
import { clumpedPlaces, makeScatter, type Copy } from "../scatter";
import { stoneGeometry } from "../stones";
import { horizonGeometry } from "./surface";

/** Side of the tile after which stones and plants repeat, over the body's size. */
const TILE = 22;

export interface Bed {
  readonly object: Object3D;
  update(focus: Vector3, height: number, time: number): void;
  dispose(): void;
}

/** Height of the dunes at a place, both over the body's size; the shader has the same. */
export const DUNES = /* glsl */ `
float dunes(vec2 p) {
  return 0.05 * sin(p.x * 0.9 + 0.6 * sin(p.y * 0.5)) + 0.04 * sin(p.y * 1.3 + 1.7) + 0.03 * sin(p.x * 2.1 - p.y * 1.1);
}
`;

function dunes(x: number, y: number): number {
  return (
    0.05 * Math.sin(x * 0.9 + 0.6 * Math.sin(y * 0.5)) +
    0.04 * Math.sin(y * 1.3 + 1.7) +
    0.03 * Math.sin(x * 2.1 - y * 1.1)
  );
}

/** `size` is the body's [m]; `grain` the size of stones and plants over it: about 1 for a fish, less for a dolphin. */
export function makeBed(water: Patch, size: number, grain: number): Bed {
  const random = randomSource(7);
  const time: IUniform<number> = { value: 0 };
  const group = new Group();
  group.name = "bed";
  const sand = makeSand(water, size, grain);
  const tile = TILE * size;
  const stones = [1, 2, 3].map((seed) => {
    const material = patchMaterial(
      new MeshStandardMaterial({ color: [0x8b8577, 0x77746d, 0x9a8f7a][seed - 1]!, roughness: 0.9 }),
      [stonePatch(size * grain), water],
    );
    return makeScatter(stoneGeometry(seed), material, stoneCopies(random, size * grain, detail.isCoarse ? 20 : 45), tile);
  });
  const grass = makeScatter(
    grassGeometry(random),
    patchMaterial(new MeshStandardMaterial({ color: 0x7fa04a, roughness: 0.6, side: DoubleSide }), [
      swayPatch(time),
      water,
    ]),
    grassCopies(random, size * grain, detail.isCoarse ? 90 : 260),
    tile,
  );
  const scattered = [...stones, grass];
  for (const scatter of scattered) {
    scatter.mesh.castShadow = !detail.isCoarse;
    scatter.mesh.receiveShadow = true;
    group.add(scatter.mesh);
  }
  group.add(sand);
  return {
    object: group,
    update(focus, height, now) {
      time.value = now;
      sand.position.set(focus.x, height, focus.z);
      const ground = (x: number, z: number): number => height + size * dunes(x / size, z / size);
      for (const scatter of scattered) {
        scatter.update(focus, ground);
      }
    },
    dispose() {
      sand.geometry.dispose();
      sand.material.dispose();
      scattered.forEach((scatter) => scatter.dispose());
    },
  };
}

function makeSand(water: Patch, size: number, grain: number): Mesh<BufferGeometry, MeshStandardMaterial> {
  const material = patchMaterial(new MeshStandardMaterial({ color: 0xc2a47a, roughness: 1 }), [
    sandPatch(size, grain),
    water,
  ]);
  const sand = new Mesh(horizonGeometry(40 * size), material);
  sand.receiveShadow = true;
  sand.frustumCulled = false;
  return sand;
}

function sandPatch(size: number, grain: number): Patch {
  return {
    key: "sand",
    uniforms: { bodySize: { value: size }, grainSize: { value: size * grain } },
    shared: `
      uniform float bodySize;
      uniform float grainSize;
      ${DUNES}
      float ripples(vec2 p) {
        float bend = 1.6 * noise2(p * 0.45) + 0.5 * noise2(p * 1.7);
        float wave = sin(dot(p, vec2(5.2, 2.6)) + 5.0 * bend);
        return (0.5 + 0.5 * wave) * (0.55 + 0.45 * noise2(p * 0.8 + 7.0));
      }`,
    vertex: `
      vec2 duneAt = (modelMatrix * vec4(transformed, 1.0)).xz / bodySize;
      transformed.y += bodySize * dunes(duneAt);`,
    colour: `
      vec2 onSand = vPlace.xz / grainSize;
      float grains = noise2(onSand * 90.0);
      float patches = fbm2(onSand * 0.7);
      diffuseColor.rgb *= 0.72 + 0.4 * patches + 0.1 * grains;
      diffuseColor.rgb *= mix(0.86, 1.06, ripples(onSand));
      diffuseColor.rgb = mix(diffuseColor.rgb, diffuseColor.rgb * vec3(0.8, 0.86, 0.72), smoothstep(0.5, 0.75, fbm2(onSand * 0.33 + 9.0)));`,
    surface: `
      #ifndef COARSE
      {
        float near = exp(-length(vViewPosition) / (7.0 * bodySize));
        float e = 0.02;
        float here = ripples(onSand);
        vec2 slope = vec2(ripples(onSand + vec2(e, 0.0)) - here, ripples(onSand + vec2(0.0, e)) - here) / e;
        vec2 at = vPlace.xz / bodySize;
        float dune = dunes(at);
        vec2 duneSlope = vec2(dunes(at + vec2(e, 0.0)) - dune, dunes(at + vec2(0.0, e)) - dune) / e;
        vec2 rough = vec2(noise2(onSand * 60.0), noise2(onSand * 60.0 + 31.0)) - 0.5;
        slope = 0.075 * near * slope + duneSlope + 0.35 * near * rough;
        normal = normalize((viewMatrix * vec4(-slope.x, 1.0, -slope.y, 0.0)).xyz);
      }
      #endif`,
  };
}

function stonePatch(size: number): Patch {
  return {
    key: "stone",
    uniforms: { stoneSize: { value: size } },
    fragment: "uniform float stoneSize;",
    colour: `
      vec2 onStone = (vPlace.xz + vPlace.yy * vec2(0.7, -0.4)) / stoneSize;
      diffuseColor.rgb *= 0.55 + 0.8 * fbm2(onStone * 9.0);
      diffuseColor.rgb = mix(diffuseColor.rgb, vec3(0.16, 0.2, 0.1), 0.55 * smoothstep(0.5, 0.7, fbm2(onStone * 3.0 + 4.0)));`,
  };
}

/** Grass sways with the water, more at its tips. */
function swayPatch(time: IUniform<number>): Patch {
  return {
    key: "sway",
    uniforms: { swayTime: time },
    shared: "uniform float swayTime; varying float vHeight;",
    vertex: `
      {
        vHeight = position.y;
        float phase = instanceMatrix[3].x * 3.1 + instanceMatrix[3].z * 2.3 + position.x * 2.0;
        float lean = position.y * position.y;
        transformed.x += lean * 0.16 * sin(1.3 * swayTime + phase + 1.5 * position.y);
        transformed.z += lean * 0.12 * sin(1.1 * swayTime + 1.7 * phase + 1.2 * position.y);
      }`,
    colour: "diffuseColor.rgb *= mix(vec3(0.5), mix(vec3(1.3, 1.15, 0.7), vec3(0.8, 1.1, 0.8), noise2(vPlace.xz * 3.0)), vHeight);",
  };
}

function stoneCopies(random: Random, size: number, count: number): Copy[] {
  return clumpedPlaces(random, count, 9, 0.09).map(([x, z]) => {
    const radius = size * (0.035 + 0.34 * random() ** 5);
    return {
      x,
      z,
      lift: 0.12 * radius,
      turn: new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), 6.3 * random()),
      scale: new Vector3(radius * (0.8 + 0.5 * random()), radius * (0.7 + 0.4 * random()), radius),
    };
  });
}

function grassCopies(random: Random, size: number, count: number): Copy[] {
  return clumpedPlaces(random, count, 14, 0.04).map(([x, z]) => {
    const height = size * (0.18 + 0.5 * random() ** 2);
    return {
      x,
      z,
      lift: 0,
      turn: new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), 6.3 * random()),
      scale: new Vector3(height, height, height),
    };
  });
}

/** A tuft of blades, of height 1. */
function grassGeometry(random: Random): BufferGeometry {
  const points: number[] = [];
  const normals: number[] = [];
  const indices: number[] = [];
  const segments = 5;
  for (let blade = 0; blade < 9; blade++) {
    const angle = 6.3 * random();
    const foot = [0.1 * (random() - 0.5), 0.1 * (random() - 0.5)] as const;
    const height = 0.5 + 0.5 * random();
    const lean = 0.3 * random();
    const width = 0.018 + 0.012 * random();
    const across = [Math.cos(angle), Math.sin(angle)] as const;
    const first = points.length / 3;
    for (let i = 0; i <= segments; i++) {
      const share = i / segments;
      const half = width * (1 - share ** 2) + 0.001;
      const out = lean * share * share;
      const x = foot[0] - out * across[1];
      const z = foot[1] + out * across[0];
      points.push(x - half * across[0], height * share, z - half * across[1]);
      points.push(x + half * across[0], height * share, z + half * across[1]);
      const normal = new Vector3(-across[1], 0.9, across[0]).normalize();
      normals.push(normal.x, normal.y, normal.z, normal.x, normal.y, normal.z);
      if (i < segments) {
        const at = first + 2 * i;
        indices.push(at, at + 1, at + 2, at + 1, at + 3, at + 2);
      }
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(points), 3));
  geometry.setAttribute("normal", new BufferAttribute(new Float32Array(normals), 3));
  geometry.setIndex(indices);
  return geometry;
}

