// Absorption and scattering of light in water, shared by every material under it, the surface and the background.

import { Color, Vector2, Vector3, type IUniform, type Texture } from "three";
import type { Patch } from "../glsl";

/** The colours of a water. */
export interface WaterColours {
  /** Looking down. */
  readonly deep: Color;
  /** Looking level. */
  readonly middle: Color;
  /** Looking up. */
  readonly bright: Color;
  readonly skyHigh: Color;
  readonly skyLow: Color;
}

export interface WaterUniforms {
  readonly surfaceHeight: IUniform<number>;
  readonly sunDirection: IUniform<Vector3>;
  readonly deepColour: IUniform<Color>;
  readonly middleColour: IUniform<Color>;
  readonly brightColour: IUniform<Color>;
  readonly skyHigh: IUniform<Color>;
  readonly skyLow: IUniform<Color>;
  /** Absorption of red, green and blue [1/m]. */
  readonly absorption: IUniform<Vector3>;
  /** Distance with little absorption [m], so that the body keeps its own colours. */
  readonly clearWay: IUniform<number>;
  readonly caustics: IUniform<Texture | null>;
  readonly causticTile: IUniform<number>;
  readonly causticDrift: IUniform<Vector2>;
}

/** Return uniforms for water; `sight` is the visibility [m], `tile` the side of the caustics' tile [m]. */
export function waterUniforms(colours: WaterColours, sun: Vector3, sight: number, tile: number): WaterUniforms {
  const uniforms = {
    surfaceHeight: { value: 0 },
    sunDirection: { value: sun.clone().normalize() },
    deepColour: { value: colours.deep },
    middleColour: { value: colours.middle },
    brightColour: { value: colours.bright },
    skyHigh: { value: colours.skyHigh },
    skyLow: { value: colours.skyLow },
    absorption: { value: new Vector3() },
    clearWay: { value: 0 },
    caustics: { value: null },
    causticTile: { value: tile },
    causticDrift: { value: new Vector2() },
  };
  clear(uniforms, sight);
  return uniforms;
}

/** Set the visibility [m]. */
export function clear({ absorption, clearWay }: Pick<WaterUniforms, "absorption" | "clearWay">, sight: number): void {
  absorption.value.set(3.2, 2.1, 1.8).divideScalar(sight);
  clearWay.value = 0.2 * sight;
}

/** The background, and the light left after a path through water. `dir` points away from the eye. */
export const WATER_GLSL = /* glsl */ `
uniform float surfaceHeight;
uniform vec3 sunDirection;
uniform vec3 deepColour;
uniform vec3 middleColour;
uniform vec3 brightColour;
uniform vec3 skyHigh;
uniform vec3 skyLow;
uniform vec3 absorption;
uniform sampler2D caustics;
uniform float causticTile;
uniform vec2 causticDrift;
uniform float clearWay;

vec3 waterColour(vec3 dir) {
  float up = dir.y;
  vec3 colour = mix(middleColour, deepColour, smoothstep(0.0, -0.75, up));
  colour = mix(colour, brightColour, smoothstep(-0.05, 0.95, up));
  float toSun = max(dot(dir, sunDirection), 0.0);
  return colour + brightColour * (0.35 * pow(toSun, 6.0) + 0.6 * pow(toSun, 40.0));
}

vec3 skyColour(vec3 dir) {
  float up = clamp(dir.y, 0.0, 1.0);
  vec3 colour = mix(skyLow, skyHigh, pow(up, 0.55));
  float cloud = smoothstep(0.45, 0.8, fbm2(dir.xz / (up + 0.12) * 1.3 + 3.0)) * smoothstep(0.02, 0.25, up);
  colour = mix(colour, vec3(1.0), 0.55 * cloud);
  float toSun = max(dot(dir, sunDirection), 0.0);
  return colour + vec3(1.0, 0.93, 0.8) * (0.25 * pow(toSun, 12.0) + 6.0 * smoothstep(0.9985, 0.9995, toSun));
}

// Length under water of the path from the eye to a place [m].
float wayThroughWater(vec3 eye, vec3 place) {
  float whole = distance(eye, place);
  float eyeDepth = surfaceHeight - eye.y;
  float placeDepth = surfaceHeight - place.y;
  if (eyeDepth >= 0.0 && placeDepth >= 0.0) return whole;
  if (eyeDepth < 0.0 && placeDepth < 0.0) return 0.0;
  float under = max(eyeDepth, placeDepth);
  return whole * under / max(under - min(eyeDepth, placeDepth), 1e-6);
}

vec3 throughWater(vec3 colour, vec3 eye, vec3 place) {
  float way = wayThroughWater(eye, place);
  way *= way / (way + clearWay);
  vec3 kept = exp(-absorption * way);
  vec3 dir = normalize(place - eye);
  return colour * kept + waterColour(dir) * (1.0 - kept);
}

// Light from the sun at a place: a net under water, weaker at depth, plain above.
vec3 sunUnderWater(vec3 place) {
  float depth = surfaceHeight - place.y;
  if (depth <= 0.0) return vec3(1.0);
  vec2 entry = place.xz + sunDirection.xz / sunDirection.y * depth;
  vec2 p = entry / causticTile;
  float fine = texture2D(caustics, p + causticDrift, 1.0).r;
  float coarse = texture2D(caustics, mat2(0.8, 0.6, -0.6, 0.8) * p * 0.63 - causticDrift, 1.0).r;
  float net = 0.4 + 0.6 * sqrt(fine * coarse);
  float blur = clamp(depth / (1.2 * causticTile), 0.0, 1.0);
  net = mix(mix(1.0, net, smoothstep(0.0, 0.12 * causticTile, depth)), mix(net, 1.0, 0.25), blur);
  return net * exp(-0.35 * absorption * depth) * 1.15;
}
`;

/** A patch that puts a material into the water. */
export function waterPatch(uniforms: WaterUniforms): Patch {
  return {
    key: "water",
    uniforms: { ...uniforms },
    fragment: WATER_GLSL,
    light: "sunUnderWater(vPlace)",
    output: "gl_FragColor.rgb = throughWater(gl_FragColor.rgb, cameraPosition, vPlace);",
  };
}
