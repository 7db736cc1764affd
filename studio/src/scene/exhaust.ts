// The engine's flame, and the dust that it blows over the ground.

import { AdditiveBlending, BufferAttribute, BufferGeometry, ConeGeometry, Group, Mesh, NormalBlending, Points, ShaderMaterial, Vector3, type Object3D } from "three";
import { randomSource } from "./random";
import type { Moment } from "./scenery";

/** Depth of the nozzle under the body's middle, over its size. */
const NOZZLE = 0.19;

/** Width and length of the flame at full thrust, over the body's size. */
const FLAME_WIDTH = 0.055;
const FLAME_LENGTH = 0.62;

const GRAINS = 900;

/** Gravity of the moon [m/s²]: dust falls slowly, without air. */
const GRAVITY = 1.62;

/** Height of the body up to which the engine raises dust, over its size. */
const REACH = 1.3;

/** Number of grains raised per second at full thrust on the ground. */
const RATE = 520;

export interface Exhaust {
  readonly object: Object3D;
  update(moment: Moment): void;
  dispose(): void;
}

export function makeExhaust(size: number): Exhaust {
  const object = new Group();
  const flame = makeFlame(size);
  const dust = makeDust(size);
  object.add(flame.object, dust.object);
  return {
    object,
    update(moment) {
      const thrust = moment.controls[0] ?? 0;
      flame.update(moment, thrust);
      dust.update(moment, thrust);
    },
    dispose() {
      flame.dispose();
      dust.dispose();
    },
  };
}

interface Part {
  readonly object: Object3D;
  update(moment: Moment, thrust: number): void;
  dispose(): void;
}

function makeFlame(size: number): Part {
  const geometry = new ConeGeometry(1, 1, 28, 12, true).translate(0, -0.5, 0).scale(1, -1, 1).translate(0, -1, 0);
  const material = new ShaderMaterial({
    uniforms: { now: { value: 0 }, thrust: { value: 0 } },
    vertexShader: `
      varying float vAlong;
      varying vec3 vNormalSeen;
      varying vec3 vToEye;
      void main() {
        vAlong = -position.y;
        vec4 seen = modelViewMatrix * vec4(position, 1.0);
        vNormalSeen = normalize(normalMatrix * normal);
        vToEye = normalize(-seen.xyz);
        gl_Position = projectionMatrix * seen;
      }`,
    fragmentShader: `
      uniform float now;
      uniform float thrust;
      varying float vAlong;
      varying vec3 vNormalSeen;
      varying vec3 vToEye;
      void main() {
        float facing = abs(dot(normalize(vNormalSeen), normalize(vToEye)));
        float flicker = 0.85 + 0.15 * sin(now * 61.0 + vAlong * 19.0);
        float glow = pow(facing, 1.6) * pow(1.0 - vAlong, 1.7) * flicker;
        vec3 colour = mix(vec3(0.35, 0.5, 1.0), vec3(1.0, 0.75, 0.5), smoothstep(0.6, 0.0, vAlong));
        gl_FragColor = vec4(colour * (0.5 + 1.8 * pow(1.0 - vAlong, 6.0)), glow * min(1.0, 0.25 + thrust));
      }`,
    transparent: true,
    depthWrite: false,
    blending: AdditiveBlending,
    side: 2,
  });
  const object = new Mesh(geometry, material);
  object.renderOrder = 8;
  object.frustumCulled = false;
  return {
    object,
    update(moment, thrust) {
      object.visible = thrust > 0.01;
      object.position.copy(moment.focus);
      object.quaternion.copy(moment.turn);
      object.translateY(-NOZZLE * size);
      const long = FLAME_LENGTH * size * (0.25 + 0.75 * thrust);
      object.scale.set(FLAME_WIDTH * size, long, FLAME_WIDTH * size);
      material.uniforms["now"]!.value = moment.time;
      material.uniforms["thrust"]!.value = thrust;
    },
    dispose() {
      geometry.dispose();
      material.dispose();
    },
  };
}

function makeDust(size: number): Part {
  const random = randomSource(31);
  const places = new Float32Array(3 * GRAINS).fill(-1e4);
  const velocities = new Float32Array(3 * GRAINS);
  const ages = new Float32Array(GRAINS).fill(1e3);
  const geometry = new BufferGeometry();
  const positions = new BufferAttribute(places, 3);
  const lives = new BufferAttribute(ages, 1);
  geometry.setAttribute("position", positions);
  geometry.setAttribute("age", lives);
  const material = new ShaderMaterial({
    uniforms: { size: { value: size } },
    vertexShader: `
      attribute float age;
      uniform float size;
      varying float vAge;
      void main() {
        vAge = age;
        vec4 seen = viewMatrix * vec4(position, 1.0);
        gl_Position = projectionMatrix * seen;
        gl_PointSize = clamp(size * (0.03 + 0.07 * age) * projectionMatrix[1][1] * 420.0 / -seen.z, 1.0, 90.0);
      }`,
    fragmentShader: `
      varying float vAge;
      void main() {
        float edge = length(gl_PointCoord - 0.5) * 2.0;
        float shade = 0.55 + 0.25 * (0.5 - gl_PointCoord.y);
        float opacity = 0.34 * smoothstep(1.0, 0.0, edge) * smoothstep(2.2, 0.6, vAge) * smoothstep(0.0, 0.12, vAge);
        gl_FragColor = vec4(vec3(0.78, 0.76, 0.73) * shade, opacity);
      }`,
    transparent: true,
    depthWrite: false,
    blending: NormalBlending,
  });
  const object = new Points(geometry, material);
  object.frustumCulled = false;
  object.renderOrder = 7;
  const down = new Vector3();
  let owed = 0;
  let next = 0;
  const raise = (moment: Moment, strength: number): void => {
    down.set(0, -1, 0).applyQuaternion(moment.turn);
    const steep = Math.max(-down.y, 0.3);
    const angle = 2 * Math.PI * random();
    const out = size * (0.06 + 0.12 * random());
    const fast = size * (0.5 + 1.1 * random()) * (0.4 + 0.6 * strength);
    const [x, z] = [Math.cos(angle), Math.sin(angle)];
    const foot = moment.focus.y / steep;
    places.set([moment.focus.x + down.x * foot + out * x, 0.03, moment.focus.z + down.z * foot + out * z], 3 * next);
    velocities.set([fast * x, fast * (0.05 + 0.25 * random() ** 2), fast * z], 3 * next);
    ages[next] = 0;
    next = (next + 1) % GRAINS;
  };
  return {
    object,
    update(moment, thrust) {
      const height = Math.max(moment.low, 0);
      const strength = thrust * Math.max(1 - height / (REACH * size), 0) ** 1.5;
      owed = Math.min(owed + RATE * strength * moment.seconds, 60);
      for (; owed >= 1; owed--) {
        raise(moment, strength);
      }
      for (let i = 0; i < GRAINS; i++) {
        ages[i]! += moment.seconds;
        if (ages[i]! > 3) {
          continue;
        }
        velocities[3 * i + 1]! -= GRAVITY * moment.seconds;
        for (let axis = 0; axis < 3; axis++) {
          places[3 * i + axis]! += velocities[3 * i + axis]! * moment.seconds;
        }
        places[3 * i + 1] = Math.max(places[3 * i + 1]!, 0.02);
      }
      positions.needsUpdate = true;
      lives.needsUpdate = true;
    },
    dispose() {
      geometry.dispose();
      material.dispose();
    },
  };
}
