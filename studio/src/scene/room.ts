// Endless floors: a hall, a table, and a studio for bodies without surroundings of their own.

import { BufferGeometry, Color, Mesh, MeshStandardMaterial, Vector3, type Object3D } from "three";
import { patchMaterial, type Patch } from "./glsl";
import type { Measure, Moment, Scenery } from "./scenery";
import { disposeOf } from "./dispose";
import { makeDome, skyAlone } from "./sky";
import type { Stage } from "./stage";
import { horizonGeometry } from "./water/surface";

/** Depth of the floor under a hanging body, over its size. */
const FLOOR_DEPTH = 0.08;

/** The looks of a room: GLSL that sets `vec3 sky` by the direction `dir`, and a floor. */
interface RoomStyle {
  /** Colour into which the floor fades with distance. */
  readonly far: Color;
  readonly wall: string;
  readonly floor: Omit<Patch, "uniforms">;
  readonly floorColour: Color;
  readonly roughness: number;
  readonly environmentIntensity: number;
}

/** Lines on a floor; `p` in widths of its squares. */
const LINES = `
  uniform float gridSize;
  float lines(vec2 p, float width) {
    vec2 w = fwidth(p) + 1e-6;
    vec2 d = abs(fract(p - 0.5) - 0.5) / w;
    return (1.0 - smoothstep(0.0, width, min(d.x, d.y))) * clamp(0.35 / max(w.x, w.y), 0.0, 1.0);
  }`;

function studioStyle(wall: Color, floor: Color, environmentIntensity: number): RoomStyle {
  return {
    far: floor,
    wall: `sky = mix(far, vec3(${wall.toArray().join(", ")}), smoothstep(-0.05, 0.35, dir.y));`,
    floor: {
      key: "grid",
      fragment: LINES,
      colour: `
        float lined = 0.5 * lines(vPlace.xz / gridSize, 1.3) + 0.22 * lines(vPlace.xz / gridSize * 5.0, 1.2);
        diffuseColor.rgb = mix(diffuseColor.rgb, diffuseColor.rgb * 1.9, lined);`,
    },
    floorColour: floor,
    roughness: 0.55,
    environmentIntensity,
  };
}

/** A bright wall with tall windows all around, out of focus as behind a portrait. */
const WINDOWED_WALL = `
  float around = fract(atan(dir.z, dir.x) * 1.4323945) - 0.5;
  float pane = smoothstep(0.3, 0.24, abs(around)) * smoothstep(0.07, 0.1, dir.y) * smoothstep(0.52, 0.46, dir.y);
  float bars = smoothstep(0.012, 0.03, abs(around)) * smoothstep(0.006, 0.016, abs(dir.y - 0.27));
  vec3 outside = mix(vec3(0.75, 0.86, 0.8), vec3(0.62, 0.8, 1.0), smoothstep(0.12, 0.4, dir.y));
  vec3 plaster = mix(vec3(0.5, 0.46, 0.41), vec3(0.66, 0.63, 0.58), smoothstep(0.0, 0.5, dir.y));
  sky = mix(plaster, vec3(0.78, 0.76, 0.72), smoothstep(0.6, 0.75, dir.y));
  sky = mix(sky, outside, pane * (0.35 + 0.65 * bars));
  sky = mix(far, sky, smoothstep(-0.005, 0.03, dir.y));`;

/** A hall with a floor of oak. */
const HALL: RoomStyle = {
  far: new Color(0.36, 0.27, 0.18),
  wall: WINDOWED_WALL,
  floor: {
    key: "boards",
    colour: `
      vec2 onFloor = vPlace.xz / vec2(1.3, 0.14);
      float row = floor(onFloor.y);
      onFloor.x += 0.618 * row;
      float tone = noise2(vec2(floor(onFloor.x) * 5.3, row * 3.1));
      float grain = noise2(vec2(vPlace.x * 5.0 + 13.0 * row, vPlace.z * 90.0));
      vec2 across = min(fract(onFloor), 1.0 - fract(onFloor)) * vec2(1.3, 0.14);
      float gap = mix(1.0, smoothstep(0.0, 0.005, min(across.x, across.y)), exp(-length(vViewPosition) / 9.0));
      diffuseColor.rgb *= (0.75 + 0.4 * tone) * (0.85 + 0.3 * grain) * mix(0.45, 1.0, gap);`,
  },
  floorColour: new Color(0.42, 0.26, 0.13),
  roughness: 0.5,
  environmentIntensity: 0.75,
};

/** A table with a checked cloth. */
const TABLE: RoomStyle = {
  far: new Color(0.42, 0.46, 0.52),
  wall: WINDOWED_WALL,
  floor: {
    key: "tablecloth",
    fragment: "uniform float gridSize;",
    colour: `
      vec2 onCloth = vPlace.xz / (0.6 * gridSize);
      vec2 soft = fwidth(onCloth) + 1e-4;
      vec2 stripes = smoothstep(-soft, soft, abs(fract(onCloth) - 0.5) - 0.25);
      stripes = mix(stripes, vec2(0.5), smoothstep(0.2, 0.6, soft));
      vec2 thread = vPlace.xz * 900.0;
      float weave = mix(1.0, 0.94 + 0.12 * noise2(thread), exp(-length(vViewPosition) / 0.7));
      diffuseColor.rgb = mix(vec3(0.8, 0.8, 0.77), vec3(0.13, 0.27, 0.5), 0.5 * (stripes.x + stripes.y)) * weave;`,
  },
  floorColour: new Color(1, 1, 1),
  roughness: 0.9,
  environmentIntensity: 0.75,
};

const STUDIO_DARK = studioStyle(new Color(0.028, 0.034, 0.045), new Color(0.075, 0.085, 0.1), 0.55);
const STUDIO_LIGHT = studioStyle(new Color(0.6, 0.64, 0.69), new Color(0.33, 0.35, 0.38), 0.7);

/** Return a room around the body: a hall, a table in it, or, for strangers' bodies, a plain studio in the page's colours. */
export function makeRoom(kind: "hall" | "table" | "plain", stage: Stage, measure: Measure, floorHeight: number | null, isDark: boolean): Scenery {
  if (kind === "plain") {
    return makeStyled(isDark ? STUDIO_DARK : STUDIO_LIGHT, stage, measure, floorHeight);
  }
  return makeStyled(kind === "hall" ? HALL : TABLE, stage, measure, floorHeight);
}

function makeStyled(style: RoomStyle, stage: Stage, measure: Measure, floorHeight: number | null): Scenery {
  const { size } = measure;
  const floor = floorHeight ?? measure.low - FLOOR_DEPTH * size;
  const dome = makeDome(100 * size, { far: { value: style.far } }, "uniform vec3 far;", style.wall);
  const ground = makeFloor(style, size);
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
      environmentIntensity: style.environmentIntensity,
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

function makeFloor(style: RoomStyle, size: number): Mesh<BufferGeometry, MeshStandardMaterial> {
  const patch: Patch = {
    ...style.floor,
    uniforms: { gridSize: { value: gridStep(size) }, bodySize: { value: size }, far: { value: style.far } },
    fragment: `uniform float bodySize; uniform vec3 far; ${style.floor.fragment ?? ""}`,
    output: `
      float away = 1.0 - exp(-length(vViewPosition) / (9.0 * bodySize));
      gl_FragColor.rgb = mix(gl_FragColor.rgb, far, away * away);`,
  };
  const material = patchMaterial(
    new MeshStandardMaterial({ color: style.floorColour, roughness: style.roughness, envMapIntensity: 0.6 }),
    [patch],
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
