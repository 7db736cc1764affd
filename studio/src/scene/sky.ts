// A dome of sky around everything, and its light.

import { BackSide, Color, Mesh, Scene, ShaderMaterial, SphereGeometry, Vector3 } from "three";
import { NOISE, type Uniforms } from "./glsl";

/** Draws every direction `dir` with the piece of shader `colour`, which sets `vec3 sky`. */
export function makeDome(radius: number, uniforms: Uniforms, declarations: string, colour: string): Mesh<SphereGeometry, ShaderMaterial> {
  const material = new ShaderMaterial({
    uniforms,
    vertexShader: `
      varying vec3 vDirection;
      void main() {
        vDirection = position;
        gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
      }`,
    fragmentShader: `
      varying vec3 vDirection;
      ${NOISE}
      ${declarations}
      void main() {
        vec3 dir = normalize(vDirection);
        vec3 sky = vec3(0.0);
        ${colour}
        gl_FragColor = vec4(sky, 1.0);
        #include <tonemapping_fragment>
        #include <colorspace_fragment>
      }`,
    side: BackSide,
    depthWrite: false,
  });
  const dome = new Mesh(new SphereGeometry(radius, 32, 24), material);
  dome.frustumCulled = false;
  dome.renderOrder = -10;
  return dome;
}

/** Return a scene of a dome alone, for reflections. */
export function skyAlone(uniforms: Uniforms, declarations: string, colour: string): Scene {
  const scene = new Scene();
  scene.add(makeDome(10, uniforms, declarations, colour));
  return scene;
}

/** The sun's direction and colours of a clear day, as a shader's uniforms. */
export function dayUniforms(sun: Vector3): Uniforms {
  return {
    sunDirection: { value: sun.clone().normalize() },
    skyHigh: { value: new Color(0.13, 0.33, 0.68) },
    skyLow: { value: new Color(0.62, 0.75, 0.86) },
  };
}

export const DAY_DECLARATIONS = /* glsl */ `
uniform vec3 sunDirection;
uniform vec3 skyHigh;
uniform vec3 skyLow;
vec3 daySky(vec3 dir) {
  float up = clamp(dir.y, 0.0, 1.0);
  vec3 colour = mix(skyLow, skyHigh, pow(up, 0.6));
  float cloud = smoothstep(0.48, 0.85, fbm2(dir.xz / (up + 0.15) * 1.1 + 5.0)) * smoothstep(0.02, 0.3, up);
  colour = mix(colour, vec3(1.0), 0.6 * cloud);
  float toSun = max(dot(dir, sunDirection), 0.0);
  return colour + vec3(1.0, 0.92, 0.78) * (0.3 * pow(toSun, 10.0) + 8.0 * smoothstep(0.9988, 0.9996, toSun));
}
`;
