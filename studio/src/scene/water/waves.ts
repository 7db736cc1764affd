// The water's surface as a sum of waves, periodic in a tile: for its shape, its glitter and the light below it.

import { Vector4, type IUniform } from "three";

/** Waves of a tile: whole periods along both sides, phase, share of the height. */
const WAVES: readonly (readonly [number, number, number, number])[] = [
  [1, 2, 0.3, 0.9],
  [-2, 1, 1.7, 0.8],
  [3, 1, 4.1, 0.55],
  [-1, 3, 2.2, 0.5],
  [2, -4, 5.3, 0.34],
  [4, 3, 0.9, 0.3],
  [-5, 2, 3.6, 0.24],
  [1, -6, 1.1, 0.2],
  [6, 4, 2.9, 0.13],
  [-4, -7, 4.6, 0.11],
];

export const WAVE_COUNT = WAVES.length;

/** The waves as a uniform: (k.x, k.y [1/tile], phase, height). */
export function waveUniform(): IUniform<Vector4[]> {
  return { value: WAVES.map(([x, y, phase, height]) => new Vector4(x, y, phase, height)) };
}

/**
 * Height, slope and curvature of the surface at `p`, in tiles: unit waves times `waveHeight`, which scales with the tile.
 * Short waves are slower, as in deep water: ω ~ √k.
 */
export const WAVES_GLSL = /* glsl */ `
#define WAVE_COUNT ${WAVE_COUNT}
uniform vec4 waves[WAVE_COUNT];
uniform float waveTime;
vec3 waveHeightAndSlope(vec2 p) {
  vec3 sum = vec3(0.0);
  for (int i = 0; i < WAVE_COUNT; i++) {
    vec2 k = 6.2831853 * waves[i].xy;
    float angle = dot(k, p) + waves[i].z + waveTime * sqrt(length(waves[i].xy)) * (i % 2 == 0 ? 1.0 : -1.0);
    sum += waves[i].w * vec3(sin(angle), cos(angle) * k);
  }
  return sum;
}
vec3 waveBending(vec2 p) {
  vec3 sum = vec3(0.0);
  for (int i = 0; i < WAVE_COUNT; i++) {
    vec2 k = 6.2831853 * waves[i].xy;
    float angle = dot(k, p) + waves[i].z + waveTime * sqrt(length(waves[i].xy)) * (i % 2 == 0 ? 1.0 : -1.0);
    sum -= waves[i].w * sin(angle) * vec3(k.x * k.x, k.x * k.y, k.y * k.y);
  }
  return sum;
}
`;
