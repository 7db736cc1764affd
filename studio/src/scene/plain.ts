// An endless studio floor, for bodies without surroundings of their own.

import { BufferGeometry, Color, Mesh, MeshStandardMaterial, Vector3, type Object3D } from "three";
import { patchMaterial, type Patch } from "./glsl";
import type { Measure, Moment, Scenery } from "./scenery";
import { disposeOf } from "./dispose";
import { makeDome, skyAlone } from "./sky";
import type { Stage } from "./stage";
import { horizonGeometry } from "./water/surface";

/** Depth of the floor under a hanging body, over its size. */
const FLOOR_DEPTH = 0.08;

const WALL = "uniform vec3 wall; uniform vec3 floorColour;";
const WALL_COLOUR = "sky = mix(floorColour, wall, smoothstep(-0.05, 0.35, dir.y));";

export interface PlainColours {
  readonly wall: Color;
  readonly floor: Color;
}

const DARK: PlainColours = { wall: new Color(0.028, 0.034, 0.045), floor: new Color(0.075, 0.085, 0.1) };
const LIGHT: PlainColours = { wall: new Color(0.6, 0.64, 0.69), floor: new Color(0.33, 0.35, 0.38) };

export function makePlain(stage: Stage, measure: Measure, floorHeight: number | null, isDark: boolean): Scenery {
  const { size } = measure;
  const colours = isDark ? DARK : LIGHT;
  const floor = floorHeight ?? measure.low - FLOOR_DEPTH * size;
  const uniforms = { wall: { value: colours.wall }, floorColour: { value: colours.floor } };
  const dome = makeDome(100 * size, uniforms, WALL, WALL_COLOUR);
  const ground = makeFloor(colours, size);
  ground.position.y = floor;
  const objects: Object3D[] = [dome, ground];
  stage.scene.add(...objects);
  stage.reflect(softboxes());
  return {
    atmosphere: {
      sunDirection: new Vector3(0.5, 1, 0.65),
      sunColour: new Color(1, 0.97, 0.92),
      sunIntensity: 3.4,
      shadowRadius: 7,
      environmentIntensity: isDark ? 0.55 : 0.7,
      exposure: 1,
    },
    bodyPatches: [],
    ground: floor,
    update(moment: Moment) {
      dome.position.copy(stage.camera.position);
      ground.position.set(moment.focus.x, floor, moment.focus.z);
    },
    dispose() {
      stage.scene.remove(...objects);
      objects.forEach((object) => object.traverse(disposeOf));
    },
  };
}

function makeFloor(colours: PlainColours, size: number): Mesh<BufferGeometry, MeshStandardMaterial> {
  const grid: Patch = {
    key: "grid",
    uniforms: { gridSize: { value: gridStep(size) }, bodySize: { value: size }, far: { value: colours.floor } },
    fragment: `
      uniform float gridSize;
      uniform float bodySize;
      uniform vec3 far;
      float lines(vec2 p, float width) {
        vec2 w = fwidth(p) + 1e-6;
        vec2 d = abs(fract(p - 0.5) - 0.5) / w;
        return (1.0 - smoothstep(0.0, width, min(d.x, d.y))) * clamp(0.35 / max(w.x, w.y), 0.0, 1.0);
      }`,
    colour: `
      float lined = 0.5 * lines(vPlace.xz / gridSize, 1.3) + 0.22 * lines(vPlace.xz / gridSize * 5.0, 1.2);
      diffuseColor.rgb = mix(diffuseColor.rgb, diffuseColor.rgb * 1.9, lined);`,
    output: `
      float away = 1.0 - exp(-length(vViewPosition) / (9.0 * bodySize));
      gl_FragColor.rgb = mix(gl_FragColor.rgb, far, away * away);`,
  };
  const material = patchMaterial(
    new MeshStandardMaterial({ color: colours.floor, roughness: 0.55, envMapIntensity: 0.6 }),
    [grid],
  );
  const floor = new Mesh(horizonGeometry(40 * size), material);
  floor.receiveShadow = true;
  floor.frustumCulled = false;
  return floor;
}

/** Distance of the floor's lines: a round number of metres. */
function gridStep(size: number): number {
  return 10 ** Math.round(Math.log10(size));
}

/** Bright panels above and beside, as photographers use them. */
function softboxes(): ReturnType<typeof skyAlone> {
  const colour = `
    float top = smoothstep(0.55, 0.8, dir.y);
    float side = smoothstep(0.6, 0.8, dot(dir, normalize(vec3(-0.9, 0.35, 0.5)))) ;
    float rim = smoothstep(0.8, 0.92, dot(dir, normalize(vec3(0.6, 0.2, -0.9))));
    sky = vec3(0.25) + vec3(1.9) * top + vec3(1.3, 1.4, 1.6) * side + vec3(2.0, 1.8, 1.5) * rim;`;
  return skyAlone({}, "", colour);
}
