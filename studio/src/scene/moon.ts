// The moon: grey dust, craters and hills under a black sky with the earth; and the engine's effect on the dust.

import {
  BufferAttribute,
  BufferGeometry,
  Color,
  Group,
  InstancedMesh,
  Matrix4,
  Mesh,
  MeshStandardMaterial,
  Quaternion,
  Vector3,
} from "three";
import { makeExhaust } from "./exhaust";
import { detail, patchMaterial, type Patch } from "./glsl";
import { disposeOf } from "./dispose";
import { randomSource } from "./random";
import type { Measure, Moment, Scenery } from "./scenery";
import { makeDome, skyAlone } from "./sky";
import { stoneGeometry } from "./stones";
import type { Stage } from "./stage";

/** Half the side of the flat ground of the physics [m]; hills begin beyond. */
const FLAT = 22;

/** Half the side of the land [m], and number of cells along each side. */
const LAND = 420;
const CELLS = 220;

const SUN = new Vector3(0.2, 0.52, -0.95);

/** Craters: x, z, radius [m]. The small ones on the flat ground are only painted. */
const CRATERS: readonly (readonly [number, number, number])[] = [
  [44, -38, 17], [-52, 30, 22], [20, 62, 14], [-36, -54, 13], [82, 24, 26], [-96, -34, 34],
  [10, -96, 28], [66, 88, 20], [-70, 92, 30], [130, -60, 44], [-150, 40, 48], [40, 150, 40], [-24, 34, 6],
  [30, 26, 5], [-34, 2, 5], [33, -12, 7], [6, 38, 5], [-12, -36, 6],
];

const STARS = /* glsl */ `
  vec3 cell = floor(dir * 130.0);
  vec3 inside = fract(dir * 130.0) - 0.5;
  float chance = hash12(cell.xy + cell.z * 17.3);
  float star = smoothstep(0.28, 0.0, length(inside)) * step(0.985, chance);
  sky = vec3(star * (0.25 + 1.6 * fract(chance * 71.0)));
  float band = exp(-8.0 * pow(dot(dir, normalize(vec3(0.5, 0.5, -0.7))), 2.0));
  sky += band * 0.018 * fbm2(dir.xy * 6.0 + dir.zz * 3.0) * vec3(0.8, 0.9, 1.1);
  vec3 toEarth = normalize(vec3(-0.75, 0.3, 0.35));
  float size = 0.075;
  vec3 right = normalize(cross(vec3(0.0, 1.0, 0.0), toEarth));
  vec2 disc = vec2(dot(dir, right), dot(dir, cross(toEarth, right))) / size;
  float r = length(disc);
  if (dot(dir, toEarth) > 0.0 && r < 1.25) {
    vec3 n = vec3(disc, sqrt(max(1.0 - r * r, 0.0)));
    float lit = smoothstep(-0.1, 0.5, dot(n, normalize(vec3(-0.6, 0.45, 0.4))));
    float land = smoothstep(0.52, 0.6, fbm2(n.xy * 2.4 + 4.0));
    float cloud = smoothstep(0.45, 0.75, fbm2(n.xy * vec2(3.0, 5.5) + 11.0));
    vec3 earth = mix(vec3(0.03, 0.13, 0.36), vec3(0.16, 0.2, 0.08), land);
    earth = mix(earth, vec3(0.85), cloud);
    float edge = smoothstep(1.0, 0.97, r);
    sky = mix(sky, earth * lit * 1.3 + vec3(0.1, 0.25, 0.6) * lit * pow(r, 6.0), edge);
    sky += (1.0 - edge) * smoothstep(1.25, 1.0, r) * lit * vec3(0.06, 0.14, 0.32);
  }
  sky *= smoothstep(-0.02, 0.02, dir.y);
`;

export function makeMoon(stage: Stage, measure: Measure): Scenery {
  const group = new Group();
  group.name = "moon";
  const dome = makeDome(1200, {}, "", STARS);
  const exhaust = makeExhaust(measure.size);
  group.add(dome, makeLand(), makeRocks(), exhaust.object);
  stage.scene.add(group);
  stage.reflect(
    skyAlone({ sun: { value: SUN.clone().normalize() } }, "uniform vec3 sun;", `
      sky = dir.y > 0.0 ? vec3(0.03) : vec3(0.36, 0.35, 0.34);
      sky += vec3(9.0) * smoothstep(0.985, 0.995, dot(dir, sun));
      sky += vec3(0.2, 0.4, 0.8) * smoothstep(0.985, 0.995, dot(dir, normalize(vec3(-0.75, 0.3, 0.35))));`),
  );
  return {
    atmosphere: {
      sunDirection: SUN,
      sunColour: new Color(1, 0.98, 0.95),
      sunIntensity: 4.6,
      shadowRadius: 1.6,
      environmentIntensity: 1.1,
      exposure: 0.95,
    },
    bodyPatches: [],
    ground: 0,
    update(moment: Moment) {
      dome.position.copy(stage.camera.position);
      exhaust.update(moment);
    },
    dispose() {
      stage.scene.remove(group);
      group.traverse(disposeOf);
      exhaust.dispose();
    },
  };
}

/** Height of the land at a place [m]: flat where physics is, craters and hills beyond. */
function landHeight(x: number, z: number): number {
  const beyond = Math.max(Math.abs(x), Math.abs(z)) - FLAT;
  const share = Math.min(Math.max(beyond / 30, 0), 1);
  const far = share * share * (3 - 2 * share);
  let height =
    2.2 * Math.sin(0.031 * x + 1) * Math.cos(0.027 * z) +
    1.1 * Math.sin(0.071 * x - 0.045 * z) +
    0.4 * Math.sin(0.17 * z + 0.11 * x);
  const distance = Math.hypot(x, z);
  height += 34 * Math.min(Math.max((distance - 150) / 260, 0), 1) ** 2 * (1 + 0.5 * Math.sin(0.021 * x + 0.017 * z) + 0.4 * Math.sin(0.05 * z));
  for (const [cx, cz, radius] of CRATERS) {
    const away = Math.hypot(x - cx, z - cz) / radius;
    if (away < 2) {
      height += radius * craterProfile(away);
    }
  }
  return far * height - 0.004;
}

/** A bowl with a raised rim, over the radius. */
function craterProfile(away: number): number {
  const bowl = away < 1 ? -0.2 * (1 - away * away) : 0;
  const rim = 0.075 * Math.exp(-(((away - 1) / 0.22) ** 2));
  return bowl + rim;
}

function makeLand(): Mesh {
  const positions = new Float32Array(3 * (CELLS + 1) ** 2);
  const indices: number[] = [];
  const along = (i: number): number => {
    const share = (2 * i) / CELLS - 1;
    return LAND * (0.22 * share + 0.78 * share ** 3);
  };
  for (let row = 0; row <= CELLS; row++) {
    for (let column = 0; column <= CELLS; column++) {
      const point = row * (CELLS + 1) + column;
      const [x, z] = [along(column), along(row)];
      positions.set([x, landHeight(x, z), z], 3 * point);
      if (row < CELLS && column < CELLS) {
        const beyond = point + CELLS + 1;
        indices.push(point, beyond, point + 1, point + 1, beyond, beyond + 1);
      }
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setIndex(indices);
  geometry.computeVertexNormals();
  const material = patchMaterial(new MeshStandardMaterial({ color: 0x8d8b88, roughness: 1 }), [dustPatch()]);
  const land = new Mesh(geometry, material);
  land.receiveShadow = true;
  return land;
}

/** Dust: fine grain up close, and pits of all sizes. */
function dustPatch(): Patch {
  return {
    key: "moondust",
    uniforms: {},
    fragment: `
      // Height of small pits, one in most cells, each with a rim.
      float pits(vec2 p) {
        vec2 cell = floor(p);
        float height = 0.0;
        for (int x = -1; x <= 1; x++) {
          for (int y = -1; y <= 1; y++) {
            vec2 at = cell + vec2(float(x), float(y));
            float chance = hash12(at);
            vec2 middle = at + 0.25 + 0.5 * vec2(hash12(at + 7.1), hash12(at + 3.7));
            float radius = 0.1 + 0.3 * chance * chance;
            float away = length(p - middle) / radius;
            float bowl = away < 1.0 ? -0.28 * (1.0 - away * away) : 0.0;
            height += radius * (bowl + 0.1 * exp(-pow((away - 1.0) / 0.25, 2.0))) * step(0.25, chance);
          }
        }
        return height;
      }
      float groundHeight(vec2 p, float closeBy) {
        return 2.2 * pits(p / 3.6) + closeBy * (0.8 * pits(p / 1.1 + 5.0) + 0.05 * fbm2(p * 2.6));
      }`,
    colour: `
      vec2 onDust = vPlace.xz;
      float broad = fbm2(onDust * 0.035);
      float fine = fbm2(onDust * 0.9 + 40.0);
      diffuseColor.rgb *= 0.55 + 0.55 * broad + 0.3 * fine;
      diffuseColor.rgb *= mix(1.0, 0.82 + 0.36 * noise2(onDust * 26.0), exp(-length(vViewPosition) / 25.0));`,
    surface: `
      #ifndef COARSE
      {
        float away = length(vViewPosition);
        float closeBy = exp(-away / 20.0);
        float e = 0.02 + 0.003 * away;
        float here = groundHeight(onDust, closeBy);
        vec2 slope = vec2(groundHeight(onDust + vec2(e, 0.0), closeBy) - here, groundHeight(onDust + vec2(0.0, e), closeBy) - here) / e;
        slope *= exp(-away / 160.0);
        vec2 rough = (vec2(noise2(onDust * 30.0), noise2(onDust * 30.0 + 13.0)) - 0.5) * 0.6 * closeBy;
        normal = normalize(normal + (viewMatrix * vec4(-slope.x - rough.x, 0.0, -slope.y - rough.y, 0.0)).xyz);
      }
      #endif`,
  };
}

function makeRocks(): InstancedMesh {
  const random = randomSource(9);
  const geometry = stoneGeometry(4);
  const material = patchMaterial(new MeshStandardMaterial({ color: 0x83807d, roughness: 1 }), [rockPatch()]);
  const rocks = new InstancedMesh(geometry, material, detail.isCoarse ? 80 : 260);
  for (let i = 0; i < rocks.count; i++) {
    const angle = 2 * Math.PI * random();
    const distance = 9 + 110 * random() ** 1.5;
    const [x, z] = [distance * Math.cos(angle), distance * Math.sin(angle)];
    const radius = 0.06 + 0.9 * random() ** 6 + (distance > 40 ? 1.6 * random() ** 9 : 0);
    const turn = new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), 6.3 * random());
    const place = new Vector3(x, landHeight(x, z) + 0.15 * radius, z);
    rocks.setMatrixAt(i, new Matrix4().compose(place, turn, new Vector3(radius, radius * (0.6 + 0.6 * random()), radius)));
  }
  rocks.castShadow = true;
  rocks.receiveShadow = true;
  rocks.frustumCulled = false;
  return rocks;
}

function rockPatch(): Patch {
  return {
    key: "moonrock",
    uniforms: {},
    colour: "diffuseColor.rgb *= 0.6 + 0.8 * fbm2((vPlace.xz + vPlace.yy * vec2(0.8, -0.6)) * 5.0);",
  };
}
