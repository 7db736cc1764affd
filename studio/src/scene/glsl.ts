// Shader pieces that several scenes share, and their insertion into three.js' own materials.

import { ShaderChunk, type IUniform, type Material, type WebGLProgramParametersWithUniforms } from "three";

export type Uniforms = Record<string, IUniform>;

/** Value noise of two and three dimensions, and its sum over octaves. */
export const NOISE = /* glsl */ `
float hash12(vec2 p) {
  vec3 q = fract(vec3(p.xyx) * 0.1031);
  q += dot(q, q.yzx + 33.33);
  return fract((q.x + q.y) * q.z);
}
float noise2(vec2 p) {
  vec2 i = floor(p);
  vec2 f = fract(p);
  f = f * f * (3.0 - 2.0 * f);
  float a = mix(hash12(i), hash12(i + vec2(1.0, 0.0)), f.x);
  float b = mix(hash12(i + vec2(0.0, 1.0)), hash12(i + vec2(1.0, 1.0)), f.x);
  return mix(a, b, f.y);
}
#ifdef COARSE
#define OCTAVES 2
#else
#define OCTAVES 4
#endif
float fbm2(vec2 p) {
  float sum = 0.0;
  float size = 0.5;
  for (int i = 0; i < OCTAVES; i++) {
    sum += size * noise2(p);
    p = mat2(1.6, 1.2, -1.2, 1.6) * p;
    size *= 0.5;
  }
  return sum;
}
`;

/** Level of fine detail: lower if the processor draws. Set before a scene is made. */
export const detail = { isCoarse: false };

/** Code inserted into the shaders of a three.js material. */
export interface Patch {
  readonly key: string;
  readonly uniforms: Uniforms;
  /** Declarations for both shaders. */
  readonly shared?: string;
  /** Declarations for the vertex shader alone, including attributes. */
  readonly attributes?: string;
  /** After `objectNormal` is known. */
  readonly normal?: string;
  /** Declarations for the fragment shader alone. */
  readonly fragment?: string;
  /** After `transformed` and `objectNormal` are known, before they are projected. */
  readonly vertex?: string;
  /** After `diffuseColor` has its colour; `roughnessFactor` is not yet known. */
  readonly colour?: string;
  /** After `roughnessFactor` and `normal` are known. */
  readonly surface?: string;
  /** A number or colour that multiplies the light of directional lights. */
  readonly light?: string;
  /** After the material's linear colour `gl_FragColor` is known, before tone mapping. */
  readonly output?: string;
}

const DIRECTIONAL_LIGHT = "getDirectionalLightInfo( directionalLight, directLight );";

/** Insert patches into a material. In every piece `vPlace` is the point in three.js' world. */
export function patchMaterial<M extends Material>(material: M, patches: readonly Patch[]): M {
  material.onBeforeCompile = (shader) => {
    for (const patch of patches) {
      Object.assign(shader.uniforms, patch.uniforms);
    }
    patchShader(shader, patches);
  };
  material.customProgramCacheKey = () => patches.map((patch) => patch.key).join("+");
  return material;
}

function patchShader(shader: WebGLProgramParametersWithUniforms, patches: readonly Patch[]): void {
  const pieces = (name: keyof Patch): string => patches.map((patch) => patch[name] ?? "").join("\n");
  const shared = `${detail.isCoarse ? "#define COARSE" : ""}\nvarying vec3 vPlace;\n${NOISE}\n${pieces("shared")}`;
  const place = `
    vec4 placed = vec4(transformed, 1.0);
    #ifdef USE_INSTANCING
      placed = instanceMatrix * placed;
    #endif
    vPlace = (modelMatrix * placed).xyz;`;
  shader.vertexShader = shader.vertexShader
    .replace("#include <common>", `#include <common>\n${shared}\n${pieces("attributes")}`)
    .replace("#include <skinnormal_vertex>", `#include <skinnormal_vertex>\n${pieces("normal")}`)
    .replace("#include <project_vertex>", `${pieces("vertex")}\n${place}\n#include <project_vertex>`);
  const light = patches.filter((patch) => patch.light);
  const dimmed = light.map((patch) => `directLight.color *= ${patch.light};`).join("\n");
  const lights = ShaderChunk.lights_fragment_begin.replaceAll(
    DIRECTIONAL_LIGHT,
    `${DIRECTIONAL_LIGHT}\n${dimmed}`,
  );
  shader.fragmentShader = shader.fragmentShader
    .replace("#include <common>", `#include <common>\n${shared}\n${pieces("fragment")}`)
    .replace("#include <color_fragment>", `#include <color_fragment>\n${pieces("colour")}`)
    .replace("#include <normal_fragment_maps>", `#include <normal_fragment_maps>\n${pieces("surface")}`)
    .replace("#include <lights_fragment_begin>", lights)
    .replace("#include <opaque_fragment>", `#include <opaque_fragment>\n${pieces("output")}`);
}
