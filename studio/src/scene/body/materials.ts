// Materials of bodies: wet skin, paint, rubber, metal; and the only colour of the physics beside the emulator.

import {
  Color,
  DoubleSide,
  FrontSide,
  MeshPhysicalMaterial,
  MeshStandardMaterial,
  ShaderMaterial,
  type IUniform,
  type Material,
  type ShaderMaterialParameters,
  type Vector3,
} from "three";
import { isClosed, type Surface } from "../../body/surface";
import { patchMaterial, type Patch, type Uniforms } from "../glsl";

/** Colour of physics beside the emulator, which no body has. */
export const GHOST_COLOUR = new Color(1.0, 0.05, 0.62);

/** Depth offset of a ghost, over the body's size: where both coincide, the body is visible. */
const GHOST_BEHIND = 0.02;

/** Colour of a body where the emulator is not trusted. */
const DOUBT_COLOUR = new Color(1.0, 0.42, 0.02);

/** Doubt of a body, 0 to 1, for all its materials at once. */
export type Doubt = IUniform<number>;

/** A patch that makes a body glow by its doubt. */
export function doubtPatch(doubt: Doubt): Patch {
  return {
    key: "doubt",
    uniforms: { doubt, doubtColour: { value: DOUBT_COLOUR } },
    fragment: "uniform float doubt; uniform vec3 doubtColour;",
    output: `
      {
        float rim = 1.0 - abs(dot(normalize(vViewPosition), normal));
        float stripe = 0.75 + 0.25 * sin(dot(gl_FragCoord.xy, vec2(0.35)));
        gl_FragColor.rgb = mix(gl_FragColor.rgb, doubtColour * (0.35 + 1.1 * rim * rim), 0.75 * doubt * stripe);
      }`,
  };
}

/** A patch that paints a swimmer in a shark's greys, dark above and pale below, by `share`, 0 to 1. */
export function sharkPatch(share: IUniform<number>): Patch {
  return {
    key: "shark",
    uniforms: { sharkShare: share },
    fragment: "uniform float sharkShare;",
    colour: `
      {
        float grey = dot(diffuseColor.rgb, vec3(0.3, 0.5, 0.2));
        vec3 back = vec3(0.10, 0.14, 0.19);
        vec3 belly = vec3(0.62, 0.68, 0.70);
        diffuseColor.rgb = mix(diffuseColor.rgb, mix(back, belly, smoothstep(0.10, 0.38, grey)), sharkShare);
      }`,
  };
}

/** A patch that paints scales on a swimmer of length `size` [m]; smooth skin has none. */
export function scalePatch(size: number, strength: number): Patch {
  return {
    key: `scales${strength > 0 ? 1 : 0}`,
    uniforms: { bodyLength: { value: size }, scaleStrength: { value: strength } },
    shared: `
      uniform float bodyLength;
      uniform float scaleStrength;
      varying vec3 vRest;
      varying float vPart;
      // Rows of overlapping discs: the distance from the middle of the topmost scale, 0 to 1.
      vec2 scaleAt(vec2 p) {
        vec2 best = vec2(1.0, 0.0);
        vec2 cell = floor(p);
        for (int i = 0; i < 2; i++) {
          float row = cell.x - float(i);
          float shift = 0.5 * mod(row, 2.0);
          float column = floor(p.y - shift);
          vec2 middle = vec2(row + 0.95, column + shift + 0.5);
          float distance = length((p - middle) * vec2(0.72, 1.25));
          if (distance < 1.0 && best.y == 0.0) best = vec2(distance, hash12(vec2(row, column)) + 0.001);
        }
        return best;
      }`,
    attributes: "attribute vec3 rest; attribute float part;",
    vertex: "vRest = rest / bodyLength; vPart = part;",
    colour: `
      {
        float around = atan(vRest.z, abs(vRest.y) + 1e-4);
        vec2 scale = scaleAt(vec2(-vRest.x * 62.0, around * 9.5));
        float onBody = smoothstep(-0.93, -0.8, vRest.x) * smoothstep(-0.13, -0.2, vRest.x) * scaleStrength;
        float near = smoothstep(6.0 * bodyLength, 1.5 * bodyLength, length(vViewPosition));
        float shade = mix(0.72, 1.12, smoothstep(1.0, 0.4, scale.x)) * (0.93 + 0.14 * scale.y);
        diffuseColor.rgb *= mix(1.0, shade, onBody * near);
        float isFin = step(0.5, vPart) * step(vPart, 1.5);
        float fan = vRest.x < -0.76 ? atan(vRest.z, -vRest.x - 0.7) * 2.4 : vRest.x + 0.5 * abs(vRest.z);
        float ray = 0.5 + 0.5 * sin(fan * 150.0);
        diffuseColor.rgb *= mix(1.0, 0.74 + 0.42 * ray, isFin * scaleStrength * near);
        float mottle = fbm2(vRest.xz * 7.0 + 3.0);
        diffuseColor.rgb *= mix(0.88 + 0.24 * mottle, 1.0, isFin);
      }`,
    surface: "if (vPart > 1.5) roughnessFactor = 0.06; else if (vPart > 0.5) roughnessFactor = 0.5;",
  };
}

/** A wet swimmer's skin; `scales` is the strength of its scales, 0 to 1. */
export function skinMaterial(size: number, scales: number, patches: readonly Patch[]): Material {
  const material = new MeshPhysicalMaterial({
    vertexColors: true,
    roughness: scales > 0 ? 0.42 : 0.36,
    metalness: 0,
    clearcoat: scales > 0 ? 0.5 : 0.45,
    clearcoatRoughness: scales > 0 ? 0.3 : 0.22,
  });
  return patchMaterial(material, [scalePatch(size, scales), ...patches]);
}

/** A soft body's skin: matte foam, in the colours of its points. */
export function softMaterial(patches: readonly Patch[]): Material {
  const material = new MeshPhysicalMaterial({
    vertexColors: true,
    roughness: 0.62,
    metalness: 0,
    clearcoat: 0.18,
    clearcoatRoughness: 0.55,
    sheen: 0.35,
    sheenRoughness: 0.6,
  });
  return patchMaterial(material, patches);
}

/** Number of threads of a cloth along its size, and the share of the sun's light that passes through it. */
const THREADS = 260;
const TRANSLUCENCY = 0.3;

/** Cloth of a colour, of `size` [m]: matte, with a sheen at grazing angles; light passes through. */
function clothMaterial(colour: Color, size: number, patches: readonly Patch[]): Material {
  const weave: Patch = {
    key: "weave",
    uniforms: { threadSize: { value: size / THREADS } },
    fragment: `
      uniform float threadSize;
      // Threads over and under each other, -1 to 1; none at distances where they would flicker.
      float weaveAt(vec2 p) {
        vec2 turns = p / threadSize;
        float far = max(length(dFdx(turns)), length(dFdy(turns)));
        vec2 waves = sin(3.14159265 * turns);
        return waves.x * waves.y * (1.0 - smoothstep(0.3, 0.9, far));
      }`,
    colour: `
      {
        vec3 away = abs(vMeanNormal);
        vec2 place = away.x > max(away.y, away.z) ? vMean.yz : away.y > away.z ? vMean.xz : vMean.xy;
        float mottle = fbm2(place / (40.0 * threadSize));
        diffuseColor.rgb *= (0.94 + 0.12 * mottle) * (1.0 + 0.16 * weaveAt(place));
      }`,
    output: `
      #if NUM_DIR_LIGHTS > 0
        float fromBehind = max(-dot(normal, directionalLights[0].direction), 0.0);
        gl_FragColor.rgb += ${TRANSLUCENCY} * fromBehind * RECIPROCAL_PI * diffuseColor.rgb * directionalLights[0].color;
      #endif`,
  };
  const material = new MeshPhysicalMaterial({
    color: colour,
    side: DoubleSide,
    roughness: 0.85,
    metalness: 0,
    sheen: 0.7,
    sheenRoughness: 0.4,
    sheenColor: colour.clone().lerp(new Color(1, 1, 1), 0.3).multiplyScalar(0.6),
  });
  return patchMaterial(material, [weave, ...patches]);
}

/** The material of a soft body's surface, by whether it is closed. */
export function surfaceMaterial(surface: Surface, colour: Color, size: number, patches: readonly Patch[]): Material {
  if (!isClosed(surface)) {
    return clothMaterial(colour, size, patches);
  }
  return surface.colours ? skinMaterial(size, 0, patches) : jellyMaterial(colour, patches);
}

/** Jelly or rubber of a colour: smooth, with a coat that shines. */
function jellyMaterial(colour: Color, patches: readonly Patch[]): Material {
  const material = new MeshPhysicalMaterial({
    color: colour,
    roughness: 0.4,
    metalness: 0,
    clearcoat: 0.6,
    clearcoatRoughness: 0.2,
    sheen: 0.3,
    sheenRoughness: 0.5,
  });
  return patchMaterial(material, patches);
}

/** The material of a cloth's fittings: dull metal. */
export function fittingsMaterial(patches: readonly Patch[]): Material {
  return patchMaterial(new MeshStandardMaterial({ color: 0x9aa3ab, roughness: 0.35, metalness: 0.7 }), patches);
}

/** Paint, rubber or metal, by colour: bright grey is metal, nearly black is rubber. */
export function shapeMaterial(colour: Color, opacity: number, patches: readonly Patch[]): MeshPhysicalMaterial {
  const { s: saturation, l: lightness } = hslOf(colour);
  const isMetal = saturation < 0.15 && lightness > 0.5;
  const isRubber = lightness < 0.16;
  const material = new MeshPhysicalMaterial({
    color: colour,
    roughness: isRubber ? 0.75 : isMetal ? 0.32 : 0.45,
    metalness: isMetal ? 0.75 : 0,
    clearcoat: isRubber || isMetal ? 0 : 0.7,
    clearcoatRoughness: 0.18,
    transparent: opacity < 1,
    opacity,
  });
  return patchMaterial(material, patches);
}

function hslOf(colour: Color): { h: number; s: number; l: number } {
  return colour.clone().convertLinearToSRGB().getHSL({ h: 0, s: 0, l: 0 });
}

/** Ground paint and other scenery: dull, and transparent in front of the look-at point `focus`. */
export function sceneryMaterial(colour: Color, focus: Vector3, patches: readonly Patch[]): Material {
  const worn: Patch = {
    key: "worn",
    uniforms: { focusPlace: { value: focus } },
    fragment: "uniform vec3 focusPlace;",
    colour: `
      {
        // Things between the eye and the body are transparent.
        vec3 toFocus = focusPlace - cameraPosition;
        float along = dot(vPlace - cameraPosition, toFocus) / dot(toFocus, toFocus);
        float aside = length(vPlace - cameraPosition - along * toFocus) / length(toFocus);
        bool isInFront = along < 0.93 && aside < 0.12 * along + 0.05 && vPlace.y > 0.08;
        if (isInFront && mod(floor(gl_FragCoord.x) + 2.0 * mod(floor(gl_FragCoord.y), 2.0), 4.0) > 0.5) discard;
      }
      float wear = fbm2(vPlace.xz * 1.7 + vPlace.yy * vec2(0.6, 1.3)) + 0.35 * noise2(vPlace.xz * 19.0);
      diffuseColor.rgb *= 0.66 + 0.5 * wear;`,
  };
  return patchMaterial(new MeshStandardMaterial({ color: colour, roughness: 0.85 }), [worn, ...patches]);
}

/** The ghost: one translucent colour that shines at its edges. A surface composed by `patches` may be seen from behind. */
export function ghostMaterial(size: number, colour = GHOST_COLOUR, patches: readonly Patch[] = []): Material {
  const uniforms: Uniforms = {
    ghostColour: { value: colour },
    behind: { value: GHOST_BEHIND * size },
  };
  const parameters: ShaderMaterialParameters = {
    uniforms,
    vertexShader: `
      #include <common>
      #include <skinning_pars_vertex>
      varying vec3 vNormalSeen;
      varying vec3 vToEye;
      uniform float behind;
      void main() {
        #include <skinbase_vertex>
        #include <beginnormal_vertex>
        #include <skinnormal_vertex>
        #include <defaultnormal_vertex>
        #include <begin_vertex>
        #include <skinning_vertex>
        #include <project_vertex>
        vec4 further = projectionMatrix * vec4(mvPosition.xyz * (1.0 + behind / length(mvPosition.xyz)), 1.0);
        gl_Position.z = further.z / further.w * gl_Position.w;
        vNormalSeen = normalize(transformedNormal);
        vToEye = normalize(-mvPosition.xyz);
      }`,
    fragmentShader: `
      uniform vec3 ghostColour;
      varying vec3 vNormalSeen;
      varying vec3 vToEye;
      void main() {
        float rim = 1.0 - abs(dot(normalize(vNormalSeen), normalize(vToEye)));
        gl_FragColor = vec4(ghostColour * (0.7 + 1.1 * rim * rim), 0.3 + 0.6 * rim);
        #include <tonemapping_fragment>
        #include <colorspace_fragment>
      }`,
    transparent: true,
    depthWrite: true,
    side: patches.length > 0 ? DoubleSide : FrontSide,
  };
  const material = new ShaderMaterial(parameters);
  return patches.length > 0 ? patchMaterial(material, patches) : material;
}

