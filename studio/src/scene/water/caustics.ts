// Caustics, the net of light that waves throw below: rays through a tile of the surface, refracted and collected.

import {
  AddEquation,
  BufferAttribute,
  BufferGeometry,
  CustomBlending,
  HalfFloatType,
  LinearFilter,
  LinearMipmapLinearFilter,
  Mesh,
  OneFactor,
  OrthographicCamera,
  RepeatWrapping,
  Scene,
  ShaderMaterial,
  WebGLRenderTarget,
  type IUniform,
  type Texture,
  type WebGLRenderer,
} from "three";
import { WAVES_GLSL, waveUniform } from "./waves";

/** Side of the picture [texels]. */
const SIZE = 256;

/** Number of rays along each side of the tile, and of the margin around it from which light enters. */
const CELLS = 80;
const MARGIN = 0.12;

/** Displacement of a ray over the slope of the surface, in tiles: depth times the strength of refraction. */
const BEND = 0.0042;

/** Maximum brightness, over that of plain light. */
const BRIGHTEST = 7;

export interface Caustics {
  readonly texture: Texture;
  update(renderer: WebGLRenderer, time: number): void;
  dispose(): void;
}

export function makeCaustics(): Caustics {
  const target = new WebGLRenderTarget(SIZE, SIZE, {
    type: HalfFloatType,
    depthBuffer: false,
    generateMipmaps: true,
    minFilter: LinearMipmapLinearFilter,
    magFilter: LinearFilter,
    wrapS: RepeatWrapping,
    wrapT: RepeatWrapping,
  });
  const waveTime: IUniform<number> = { value: 0 };
  const material = new ShaderMaterial({
    uniforms: { waves: waveUniform(), waveTime },
    vertexShader: `
      varying vec2 vOrigin;
      ${WAVES_GLSL}
      void main() {
        vOrigin = position.xy;
        vec2 landed = position.xy - ${BEND} * waveHeightAndSlope(position.xy).yz;
        gl_Position = vec4(2.0 * landed - 1.0, 0.0, 1.0);
      }`,
    fragmentShader: `
      varying vec2 vOrigin;
      ${WAVES_GLSL}
      void main() {
        vec3 bending = ${BEND} * waveBending(vOrigin);
        float area = (1.0 - bending.x) * (1.0 - bending.z) - bending.y * bending.y;
        float light = min(1.0 / max(abs(area), 1e-3), ${BRIGHTEST.toFixed(1)});
        gl_FragColor = vec4(vec3(light), 1.0);
      }`,
    blending: CustomBlending,
    blendEquation: AddEquation,
    blendSrc: OneFactor,
    blendDst: OneFactor,
    depthTest: false,
    depthWrite: false,
    side: 2,
  });
  const geometry = gridGeometry();
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  const scene = new Scene();
  scene.add(mesh);
  const camera = new OrthographicCamera();
  return {
    texture: target.texture,
    update(renderer, time) {
      waveTime.value = time;
      const shown = renderer.getRenderTarget();
      renderer.setRenderTarget(target);
      renderer.clear();
      renderer.render(scene, camera);
      renderer.setRenderTarget(shown);
    },
    dispose() {
      target.dispose();
      material.dispose();
      geometry.dispose();
    },
  };
}

function gridGeometry(): BufferGeometry {
  const points = new Float32Array(3 * (CELLS + 1) ** 2);
  const indices: number[] = [];
  for (let row = 0; row <= CELLS; row++) {
    for (let column = 0; column <= CELLS; column++) {
      const point = row * (CELLS + 1) + column;
      points[3 * point] = (column / CELLS) * (1 + 2 * MARGIN) - MARGIN;
      points[3 * point + 1] = (row / CELLS) * (1 + 2 * MARGIN) - MARGIN;
      if (row < CELLS && column < CELLS) {
        const above = point + CELLS + 1;
        indices.push(point, point + 1, above, point + 1, above + 1, above);
      }
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(points, 3));
  geometry.setIndex(indices);
  return geometry;
}
