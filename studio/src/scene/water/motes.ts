// Motes of dust that drift in the water and show speed; and shafts of light from above.

import {
  AdditiveBlending,
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Mesh,
  Points,
  ShaderMaterial,
  Vector3,
  type Object3D,
} from "three";
import { NOISE } from "../glsl";
import { randomSource } from "../random";
import { WATER_GLSL, type WaterUniforms } from "./light";

export interface Drift {
  readonly object: Object3D;
  update(focus: Vector3, time: number): void;
  dispose(): void;
}

/** Motes in a box around the look-at point, of side `box` [m]; those that leave it enter on the other side. */
export function makeMotes(water: WaterUniforms, box: number, count: number): Drift {
  const random = randomSource(3);
  const points = Float32Array.from({ length: 3 * count }, () => random());
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(points, 3));
  const material = new ShaderMaterial({
    uniforms: {
      ...water,
      focus: { value: new Vector3() },
      box: { value: box },
      now: { value: 0 },
    },
    vertexShader: `
      uniform vec3 focus;
      uniform float box;
      uniform float now;
      varying float vLight;
      varying vec3 vPlace;
      void main() {
        vec3 drift = 0.02 * vec3(sin(now * 0.3 + position.y * 40.0), sin(now * 0.23 + position.z * 40.0), now * 0.2);
        vec3 place = focus + box * (fract(position + drift - focus / box) - 0.5);
        vPlace = place;
        vec4 seen = viewMatrix * vec4(place, 1.0);
        gl_Position = projectionMatrix * seen;
        float edge = 2.0 * length(place - focus) / box;
        vLight = (0.35 + 0.65 * position.x) * smoothstep(1.0, 0.55, edge) * smoothstep(0.0, 0.06 * box, -seen.z);
        gl_PointSize = clamp(0.0045 * box * projectionMatrix[1][1] * 420.0 / -seen.z, 1.0, 9.0) * (0.5 + position.z);
      }`,
    fragmentShader: `
      varying float vLight;
      varying vec3 vPlace;
      ${NOISE}
      ${WATER_GLSL}
      void main() {
        if (vPlace.y > surfaceHeight) discard;
        float edge = length(gl_PointCoord - 0.5) * 2.0;
        float glow = vLight * smoothstep(1.0, 0.1, edge) * sunUnderWater(vPlace).g;
        gl_FragColor = vec4(brightColour + 0.35, 0.42 * glow);
      }`,
    transparent: true,
    depthWrite: false,
    blending: AdditiveBlending,
  });
  const object = new Points(geometry, material);
  object.renderOrder = 5;
  return drifting(object, geometry, material);
}

/** Shafts of light around the look-at point: bands along the sun's rays that face the eye. */
export function makeShafts(water: WaterUniforms, size: number, count: number): Drift {
  const random = randomSource(11);
  const corners: number[] = [];
  const seeds: number[] = [];
  const indices: number[] = [];
  for (let i = 0; i < count; i++) {
    const seed = [random(), random(), random()];
    for (const corner of [[-1, 0], [1, 0], [-1, 1], [1, 1]]) {
      corners.push(corner[0]!, corner[1]!, 0);
      seeds.push(...seed);
    }
    indices.push(4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 1, 4 * i + 3, 4 * i + 2);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(corners), 3));
  geometry.setAttribute("seed", new BufferAttribute(new Float32Array(seeds), 3));
  geometry.setIndex(indices);
  const material = new ShaderMaterial({
    uniforms: { ...water, focus: { value: new Vector3() }, size: { value: size }, now: { value: 0 } },
    vertexShader: `
      attribute vec3 seed;
      uniform vec3 focus;
      uniform float size;
      uniform float now;
      uniform float surfaceHeight;
      uniform vec3 sunDirection;
      varying vec2 vShaft;
      varying float vLight;
      void main() {
        float tile = 16.0 * size;
        vec2 foot = tile * (seed.xy + 0.01 * vec2(sin(now * 0.11 + seed.z * 9.0), cos(now * 0.13 + seed.z * 7.0)));
        foot += tile * floor((focus.xz - foot) / tile + 0.5);
        vec3 top = vec3(foot.x, surfaceHeight, foot.y);
        vec3 along = -sunDirection / max(sunDirection.y, 0.3);
        float deep = size * (8.0 + 6.0 * seed.z);
        vec3 place = top + along * deep * position.y;
        vec3 across = normalize(cross(along, place - cameraPosition));
        place += across * position.x * size * (0.15 + 0.7 * seed.x) * (1.0 + 0.6 * position.y);
        vShaft = position.xy;
        float away = distance(place.xz, focus.xz) / tile;
        vLight = (0.35 + 0.65 * sin(now * (0.25 + 0.3 * seed.y) + 40.0 * seed.z)) * smoothstep(0.5, 0.2, away);
        gl_Position = projectionMatrix * viewMatrix * vec4(place, 1.0);
      }`,
    fragmentShader: `
      varying vec2 vShaft;
      varying float vLight;
      uniform vec3 brightColour;
      void main() {
        float edge = 1.0 - vShaft.x * vShaft.x;
        float fade = smoothstep(0.0, 0.3, vShaft.y) * pow(1.0 - vShaft.y, 1.4);
        gl_FragColor = vec4(brightColour * 0.8 + 0.2, max(0.34 * edge * edge * fade * vLight, 0.0));
      }`,
    transparent: true,
    depthWrite: false,
    blending: AdditiveBlending,
    side: DoubleSide,
  });
  const object = new Mesh(geometry, material);
  object.renderOrder = 6;
  return drifting(object, geometry, material);
}

// Positions come from `focus` and `now` in the shader, so the geometry must not be culled by its own position.
function drifting(object: Object3D, geometry: BufferGeometry, material: ShaderMaterial): Drift {
  object.frustumCulled = false;
  return {
    object,
    update(focus, time) {
      (material.uniforms["focus"]!.value as Vector3).copy(focus);
      material.uniforms["now"]!.value = time;
    },
    dispose() {
      geometry.dispose();
      material.dispose();
    },
  };
}
