// Drops that fly up where a body breaks through the surface.

import { BufferAttribute, BufferGeometry, NormalBlending, Points, ShaderMaterial, Vector3, type Object3D } from "three";
import { randomSource } from "../random";
import type { WaterUniforms } from "./light";

const DROPS = 260;
const GRAVITY = 9.81;

export interface Spray {
  readonly object: Object3D;
  /** Emit drops at a place; `strength` is 0 to 1. */
  burst(place: Vector3, strength: number): void;
  update(seconds: number): void;
  dispose(): void;
}

export function makeSpray(water: WaterUniforms, size: number): Spray {
  const random = randomSource(5);
  const places = new Float32Array(3 * DROPS).fill(-1e4);
  const velocities = new Float32Array(3 * DROPS);
  const geometry = new BufferGeometry();
  const attribute = new BufferAttribute(places, 3);
  geometry.setAttribute("position", attribute);
  const material = new ShaderMaterial({
    uniforms: { surfaceHeight: water.surfaceHeight, size: { value: size } },
    vertexShader: `
      uniform float size;
      varying float vHeight;
      void main() {
        vHeight = position.y;
        vec4 seen = viewMatrix * vec4(position, 1.0);
        gl_Position = projectionMatrix * seen;
        gl_PointSize = clamp(0.016 * size * projectionMatrix[1][1] * 420.0 / -seen.z, 1.0, 14.0);
      }`,
    fragmentShader: `
      uniform float surfaceHeight;
      varying float vHeight;
      void main() {
        if (vHeight < surfaceHeight) discard;
        float edge = length(gl_PointCoord - 0.5) * 2.0;
        gl_FragColor = vec4(vec3(0.93, 0.97, 1.0), 0.75 * smoothstep(1.0, 0.3, edge));
      }`,
    transparent: true,
    depthWrite: false,
    blending: NormalBlending,
  });
  const object = new Points(geometry, material);
  object.frustumCulled = false;
  object.renderOrder = 12;
  let next = 0;
  let isFlying = false;
  return {
    object,
    burst(place, strength) {
      const speed = Math.sqrt(2 * GRAVITY * 0.3 * size);
      for (let i = 0; i < 0.6 * DROPS; i++) {
        const angle = 2 * Math.PI * random();
        const out = 0.16 * size * random();
        const fast = speed * strength * (0.35 + 0.65 * random());
        const flat = 0.5 * random();
        places.set([place.x + out * Math.cos(angle), place.y + 1e-3, place.z + out * Math.sin(angle)], 3 * next);
        velocities.set([fast * flat * Math.cos(angle), fast, fast * flat * Math.sin(angle)], 3 * next);
        next = (next + 1) % DROPS;
      }
      isFlying = true;
    },
    update(seconds) {
      if (!isFlying) {
        return;
      }
      isFlying = false;
      for (let i = 0; i < DROPS; i++) {
        if (places[3 * i + 1]! < water.surfaceHeight.value - 1) {
          continue;
        }
        velocities[3 * i + 1]! -= GRAVITY * seconds;
        for (let axis = 0; axis < 3; axis++) {
          places[3 * i + axis]! += velocities[3 * i + axis]! * seconds;
        }
        if (places[3 * i + 1]! < water.surfaceHeight.value) {
          places[3 * i + 1] = -1e4;
        } else {
          isFlying = true;
        }
      }
      attribute.needsUpdate = true;
    },
    dispose() {
      geometry.dispose();
      material.dispose();
    },
  };
}
