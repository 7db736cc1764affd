// The water's surface, seen from above and from below, with rings where a body breaks through.

import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Mesh,
  ShaderMaterial,
  Vector3,
  Vector4,
  type IUniform,
  type Object3D,
} from "three";
import { detail, NOISE } from "../glsl";
import { WATER_GLSL, type WaterUniforms } from "./light";
import { WAVES_GLSL, waveUniform } from "./waves";

const CELLS = 150;
const COARSE_CELLS = 60;
const RINGS = 8;

/** Lifetime of a ring [s]. */
const RING_LIFE = 5;

export interface Surface {
  readonly object: Object3D;
  /** Start a ring at a place, with a `strength` of 0 to 1. */
  ring(place: Vector3, strength: number): void;
  update(focus: Vector3, time: number): void;
  dispose(): void;
}

/** `waveTile` [m] is the side of the waves' tile, `steepness` their height over it, `reach` the extent of the surface [m]. */
export function makeSurface(water: WaterUniforms, waveTile: number, steepness: number, reach: number): Surface {
  const waveTime: IUniform<number> = { value: 0 };
  const rings: IUniform<Vector4[]> = { value: [] };
  for (let i = 0; i < RINGS; i++) {
    rings.value.push(new Vector4(0, 0, -100, 0));
  }
  const material = new ShaderMaterial({
    uniforms: {
      ...water,
      waves: waveUniform(),
      waveTime,
      rings,
      now: { value: 0 },
      waveTile: { value: waveTile },
      waveHeight: { value: steepness * waveTile },
    },
    vertexShader: `
      varying vec3 vPlace;
      ${WAVES_GLSL}
      uniform float waveTile;
      uniform float waveHeight;
      void main() {
        vec4 world = modelMatrix * vec4(position, 1.0);
        world.y += waveHeight * waveHeightAndSlope(world.xz / waveTile).x;
        vPlace = world.xyz;
        gl_Position = projectionMatrix * viewMatrix * world;
      }`,
    fragmentShader: `
      varying vec3 vPlace;
      ${NOISE}
      ${WATER_GLSL}
      ${WAVES_GLSL}
      uniform float waveTile;
      uniform float waveHeight;
      uniform vec4 rings[${RINGS}];
      uniform float now;

      vec2 ringSlope(vec2 p) {
        vec2 slope = vec2(0.0);
        for (int i = 0; i < ${RINGS}; i++) {
          float age = now - rings[i].z;
          if (age < 0.0 || age > ${RING_LIFE.toFixed(1)}) continue;
          vec2 away = p - rings[i].xy;
          float radius = length(away) + 1e-5;
          float front = age * 0.42 * waveTile;
          float band = (radius - front) / (0.1 * waveTile * (1.0 + age));
          float strength = rings[i].w * exp(-band * band) * exp(-0.9 * age);
          slope += strength * cos(radius * 52.0 / waveTile) * away / radius;
        }
        return slope;
      }

      void main() {
        vec3 toEye = cameraPosition - vPlace;
        float far = length(toEye);
        toEye /= far;
        vec2 p = vPlace.xz / waveTile;
        float calm = 1.0 / (1.0 + far / (7.0 * waveTile));
        vec2 slope = waveHeight / waveTile * waveHeightAndSlope(p).yz;
        slope += 0.6 * waveHeight / waveTile * waveHeightAndSlope(p.yx * 2.7 + 0.3).yz;
        slope *= calm;
        slope += ringSlope(vPlace.xz);
        vec3 normal = normalize(vec3(-slope.x, 1.0, -slope.y));
        vec3 colour;
        float opacity;
        if (cameraPosition.y > surfaceHeight) {
          float facing = clamp(dot(normal, toEye), 0.0, 1.0);
          float mirrored = 0.02 + 0.98 * pow(1.0 - facing, 5.0);
          vec3 away = reflect(-toEye, normal);
          away.y = abs(away.y);
          vec3 glitter = vec3(1.0, 0.94, 0.82) * 14.0 * pow(max(dot(away, sunDirection), 0.0), 700.0);
          colour = skyColour(away) + glitter / max(mirrored, 0.06);
          float foam = smoothstep(0.55, 1.1, length(ringSlope(vPlace.xz)));
          opacity = clamp(mirrored + 0.12, 0.0, 1.0);
          colour = mix(colour, vec3(0.95), foam);
          opacity = max(opacity, 0.75 * foam);
          float haze = 1.0 - exp(-far / (60.0 * waveTile));
          colour = mix(colour, skyLow, haze);
          opacity = mix(opacity, 1.0, haze);
        } else {
          float facing = clamp(dot(normal, -toEye), 0.0, 1.0);
          vec3 through = refract(-toEye, -normal, 1.33);
          float sine = 1.33 * sqrt(1.0 - facing * facing);
          float mirrored = mix(0.04, 1.0, smoothstep(0.55, 1.02, sine));
          vec3 below = waterColour(reflect(-toEye, -normal));
          vec3 above = skyColour(normalize(through + vec3(0.0, 0.02, 0.0))) * 1.25 + 0.15;
          colour = mix(above, below, mirrored);
          colour = throughWater(colour, cameraPosition, vPlace);
          opacity = 1.0;
        }
        gl_FragColor = vec4(colour, opacity);
        #include <tonemapping_fragment>
        #include <colorspace_fragment>
      }`,
    transparent: true,
    depthWrite: false,
    side: DoubleSide,
  });
  const geometry = horizonGeometry(reach);
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  mesh.renderOrder = 10;
  mesh.name = "water surface";
  let next = 0;
  let now = 0;
  return {
    object: mesh,
    ring(place, strength) {
      rings.value[next]!.set(place.x, place.z, now, strength);
      next = (next + 1) % RINGS;
    },
    update(focus, time) {
      now = time;
      material.uniforms["now"]!.value = time;
      waveTime.value = time;
      mesh.position.set(focus.x, water.surfaceHeight.value, focus.z);
    },
    dispose() {
      geometry.dispose();
      material.dispose();
    },
  };
}

/** A grid, fine in the middle and coarse toward the horizon. */
export function horizonGeometry(reach: number): BufferGeometry {
  const cells = detail.isCoarse ? COARSE_CELLS : CELLS;
  const points = new Float32Array(3 * (cells + 1) ** 2);
  const normals = new Float32Array(points.length);
  const indices: number[] = [];
  const along = (i: number): number => {
    const share = (2 * i) / cells - 1;
    return reach * (0.06 * share + 0.94 * share ** 3 * Math.abs(share));
  };
  for (let row = 0; row <= cells; row++) {
    for (let column = 0; column <= cells; column++) {
      const point = row * (cells + 1) + column;
      points.set([along(column), 0, along(row)], 3 * point);
      normals[3 * point + 1] = 1;
      if (row < cells && column < cells) {
        const beyond = point + cells + 1;
        indices.push(point, beyond, point + 1, point + 1, beyond, beyond + 1);
      }
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(points, 3));
  geometry.setAttribute("normal", new BufferAttribute(normals, 3));
  geometry.setIndex(indices);
  return geometry;
}
