// A parking lot on a clear day: asphalt, a kerb, grass and trees around it, and distant hills.

import {
  BoxGeometry,
  BufferGeometry,
  Color,
  ConeGeometry,
  CylinderGeometry,
  Group,
  IcosahedronGeometry,
  InstancedMesh,
  Matrix4,
  Mesh,
  MeshStandardMaterial,
  PlaneGeometry,
  Quaternion,
  Vector3,
} from "three";
import { mergeGeometries, mergeVertices } from "three/addons/utils/BufferGeometryUtils.js";
import { patchMaterial, type Patch } from "./glsl";
import { randomSource } from "./random";
import type { Moment, Scenery } from "./scenery";
import { disposeOf } from "./dispose";
import { DAY_DECLARATIONS, dayUniforms, makeDome, skyAlone } from "./sky";
import type { Stage } from "./stage";

/** Half the side of the asphalt [m]. */
const LOT = 20;

/** Half the side of the meadow around it [m]. */
const MEADOW = 400;

const TREES = 220;

export const SUN = new Vector3(0.62, 0.85, -0.3);

/** Distant hills under the sky of a clear day. */
export const HILLS = /* glsl */ `
  sky = daySky(dir);
  float around = atan(dir.z, dir.x);
  float far = 0.035 + 0.03 * sin(around * 3.0 + 1.0) + 0.022 * sin(around * 7.0) + 0.03 * noise2(vec2(around * 9.0, 2.0));
  float near = 0.012 + 0.012 * sin(around * 5.0 + 2.0) + 0.03 * noise2(vec2(around * 16.0, 7.0));
  sky = mix(sky, mix(skyLow, vec3(0.2, 0.33, 0.42), 0.45), smoothstep(0.003, -0.003, dir.y - far));
  sky = mix(sky, mix(skyLow, vec3(0.14, 0.27, 0.17), 0.62), smoothstep(0.002, -0.002, dir.y - near));
`;

/** The haze of a clear day on distant things. */
export function hazePatch(): Patch {
  const uniforms = dayUniforms(SUN);
  return {
    key: "haze",
    uniforms: { hazeColour: uniforms["skyLow"]! },
    fragment: "uniform vec3 hazeColour;",
    output: `
      float haze = 1.0 - exp(-length(vViewPosition) / 900.0);
      gl_FragColor.rgb = mix(gl_FragColor.rgb, hazeColour, haze);`,
  };
}

export function makeLot(stage: Stage): Scenery {
  const group = new Group();
  group.name = "lot";
  const haze = hazePatch();
  const dome = makeDome(900, dayUniforms(SUN), DAY_DECLARATIONS, HILLS);
  const parts = [makeMeadow(haze), makeAsphalt(haze), makeKerb(haze), makeTrees(haze), makeLamps(haze)];
  group.add(dome, ...parts);
  stage.scene.add(group);
  stage.reflect(skyAlone(dayUniforms(SUN), DAY_DECLARATIONS, "sky = dir.y > 0.0 ? daySky(dir) : vec3(0.16, 0.16, 0.15);"));
  return {
    atmosphere: {
      sunDirection: SUN,
      sunColour: new Color(1, 0.94, 0.84),
      sunIntensity: 4.2,
      shadowRadius: 3.5,
      environmentIntensity: 0.9,
      exposure: 1,
    },
    bodyPatches: [],
    ground: 0,
    update(_: Moment) {
      dome.position.copy(stage.camera.position);
    },
    dispose() {
      stage.scene.remove(group);
      group.traverse(disposeOf);
    },
  };
}

function makeAsphalt(haze: Patch): Mesh {
  const asphalt: Patch = {
    key: "asphalt",
    uniforms: {},
    colour: `
      vec2 onLot = vPlace.xz;
      float closeBy = exp(-length(vViewPosition) / 18.0);
      float grit = mix(0.5, noise2(onLot * 55.0), closeBy);
      float worn = fbm2(onLot * 0.22);
      float stain = smoothstep(0.62, 0.8, fbm2(onLot * 0.6 + 20.0));
      diffuseColor.rgb *= 0.72 + 0.36 * worn + 0.42 * (grit - 0.5);
      diffuseColor.rgb *= 1.0 - 0.35 * stain;
      float seam = min(abs(fract(onLot.x / 10.0 + 0.5) - 0.5), abs(fract(onLot.y / 10.0 + 0.5) - 0.5)) * 10.0;
      diffuseColor.rgb *= mix(0.7, 1.0, smoothstep(0.01, 0.035, seam));
      vec2 cell = onLot * 0.35;
      float crack = abs(fbm2(cell + 3.0 * fbm2(cell)) - 0.47);
      diffuseColor.rgb *= mix(1.0, mix(0.62, 1.0, smoothstep(0.0, 0.006, crack)), closeBy);`,
    surface: `
      #ifndef COARSE
      {
        float near = exp(-length(vViewPosition) / 9.0);
        vec2 rough = vec2(noise2(onLot * 70.0), noise2(onLot * 70.0 + 17.0)) - 0.5;
        normal = normalize(normal + (viewMatrix * vec4(0.45 * near * rough.x, 0.0, 0.45 * near * rough.y, 0.0)).xyz);
        roughnessFactor -= 0.25 * stain;
      }
      #endif`,
  };
  const material = patchMaterial(new MeshStandardMaterial({ color: 0x5d5f62, roughness: 0.94 }), [asphalt, haze]);
  const mesh = new Mesh(new PlaneGeometry(2 * LOT, 2 * LOT).rotateX(-Math.PI / 2), material);
  mesh.receiveShadow = true;
  return mesh;
}

function makeMeadow(haze: Patch): Mesh {
  const meadow: Patch = {
    key: "meadow",
    uniforms: {},
    colour: `
      vec2 onMeadow = vPlace.xz;
      float tufts = mix(0.5, noise2(onMeadow * 9.0), exp(-length(vViewPosition) / 45.0));
      float broad = fbm2(onMeadow * 0.06);
      diffuseColor.rgb = mix(vec3(0.075, 0.13, 0.028), vec3(0.19, 0.2, 0.06), broad);
      diffuseColor.rgb *= 0.65 + 0.7 * tufts;`,
  };
  const material = patchMaterial(new MeshStandardMaterial({ color: 0xffffff, roughness: 1 }), [meadow, haze]);
  const mesh = new Mesh(new PlaneGeometry(2 * MEADOW, 2 * MEADOW).rotateX(-Math.PI / 2), material);
  mesh.position.y = -0.06;
  mesh.receiveShadow = true;
  return mesh;
}

function makeKerb(haze: Patch): Mesh {
  const long = 2 * LOT + 0.6;
  const sides = [0, 1, 2, 3].map((side) =>
    new BoxGeometry(long, 0.16, 0.3).translate(0, 0.02, LOT + 0.15).rotateY((side * Math.PI) / 2),
  );
  const material = patchMaterial(new MeshStandardMaterial({ color: 0xb9b6ae, roughness: 0.9 }), [haze]);
  const mesh = new Mesh(mergeGeometries(sides), material);
  mesh.castShadow = true;
  mesh.receiveShadow = true;
  return mesh;
}

/** Return trees around the origin, from a distance `nearest` [m] on. */
export function makeTrees(haze: Patch, nearest = LOT * 1.55): Group {
  const random = randomSource(21);
  const group = new Group();
  const trunk = new CylinderGeometry(0.16, 0.24, 2.2, 7).translate(0, 1.1, 0);
  const crown = mergeGeometries([
    roughBall(1.75, 3).translate(0, 3.6, 0),
    roughBall(1.25, 5).translate(0.9, 2.9, 0.5),
    roughBall(1.2, 8).translate(-0.8, 3.0, -0.5),
  ]);
  const fir = mergeGeometries([
    new ConeGeometry(1.5, 2.6, 9).translate(0, 2.3, 0),
    new ConeGeometry(1.15, 2.2, 9).translate(0, 3.7, 0),
    new ConeGeometry(0.75, 1.8, 9).translate(0, 4.9, 0),
  ]);
  const leaves: Patch = {
    key: "leaves",
    uniforms: {},
    colour: "diffuseColor.rgb *= 0.55 + 0.9 * fbm2(vPlace.xz * 2.1 + vPlace.yy * vec2(1.7, 2.3));",
  };
  const bark = patchMaterial(new MeshStandardMaterial({ color: 0x4a3a2b, roughness: 1 }), [haze]);
  const green = patchMaterial(new MeshStandardMaterial({ color: 0x4f7030, roughness: 0.95 }), [leaves, haze]);
  const dark = patchMaterial(new MeshStandardMaterial({ color: 0x2f5138, roughness: 0.95 }), [leaves, haze]);
  const places = Array.from({ length: TREES }, () => {
    const angle = 2 * Math.PI * random();
    const distance = nearest + 210 * random() ** 1.3;
    return { x: distance * Math.cos(angle), z: distance * Math.sin(angle), height: 0.9 + 1.1 * random(), isFir: random() < 0.4 };
  });
  const addCopies = (geometry: BufferGeometry, material: MeshStandardMaterial, kept: typeof places): void => {
    const copies = new InstancedMesh(geometry, material, kept.length);
    kept.forEach(({ x, z, height }, i) => {
      const turn = new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), 7 * x);
      copies.setMatrixAt(i, new Matrix4().compose(new Vector3(x, -0.05, z), turn, new Vector3(height, height, height)));
    });
    copies.frustumCulled = false;
    copies.castShadow = true;
    copies.receiveShadow = true;
    group.add(copies);
  };
  addCopies(trunk, bark, places);
  addCopies(crown, green, places.filter((place) => !place.isFir));
  addCopies(fir, dark, places.filter((place) => place.isFir));
  return group;
}

function roughBall(radius: number, seed: number): BufferGeometry {
  const geometry = mergeVertices(new IcosahedronGeometry(radius, 3).deleteAttribute("uv").deleteAttribute("normal"));
  const positions = geometry.getAttribute("position");
  for (let i = 0; i < positions.count; i++) {
    const [x, y, z] = [positions.getX(i), positions.getY(i), positions.getZ(i)];
    const bump = 1 + 0.13 * Math.sin(3.1 * x + seed) * Math.sin(2.7 * y - seed) + 0.09 * Math.sin(4.3 * z + 2 * seed);
    positions.setXYZ(i, x * bump, y * bump, z * bump);
  }
  geometry.computeVertexNormals();
  return geometry;
}

function makeLamps(haze: Patch): Group {
  const group = new Group();
  const pole = mergeGeometries([
    new CylinderGeometry(0.06, 0.09, 6, 12).translate(0, 3, 0),
    new BoxGeometry(1.5, 0.07, 0.1).translate(0.7, 6, 0),
    new BoxGeometry(0.6, 0.1, 0.26).translate(1.3, 5.98, 0),
    new CylinderGeometry(0.22, 0.26, 0.5, 16).translate(0, 0.2, 0),
  ]);
  const material = patchMaterial(new MeshStandardMaterial({ color: 0x6a7077, roughness: 0.5, metalness: 0.6 }), [haze]);
  for (const [x, z, turn] of [[-19.2, 0, 0], [19.2, 0, Math.PI], [-19.2, 16, 0], [19.2, -16, Math.PI], [-19.2, -16, 0], [19.2, 16, Math.PI]] as const) {
    const lamp = new Mesh(pole, material);
    lamp.position.set(x, 0, z);
    lamp.rotation.y = turn;
    lamp.castShadow = true;
    group.add(lamp);
  }
  return group;
}
