// The sea: a surface, caustics, a bed of sand, and water that absorbs colour.

import { Color, Vector3 } from "three";
import { disposeOf } from "../dispose";
import type { Measure, Moment, Scenery } from "../scenery";
import { makeDome, skyAlone } from "../sky";
import type { Stage } from "../stage";
import { makeBed } from "./bed";
import { makeCaustics } from "./caustics";
import { clear, WATER_GLSL, waterPatch, waterUniforms, type WaterColours } from "./light";
import { makeMotes, makeShafts } from "./motes";
import { makeSpray } from "./spray";
import { makeSurface } from "./surface";

/** Initial depth of the bed under the lowest point, and height of the surface if physics has none; over the body's size. */
const BED_DEPTH = 0.85;
const SURFACE_ABOVE = 3.2;

/** Distance of a body at which bed and surface give way, over its size. */
const ROOM = 0.3;

/** Visibility, over the body's size. */
const SIGHT = 13;

/** Size of a small body, with stones of usual size [m]; for a larger one they look smaller. */
const SMALL_BODY = 0.3;

const COLOURS: WaterColours = {
  deep: new Color(0.004, 0.045, 0.085),
  middle: new Color(0.02, 0.17, 0.25),
  bright: new Color(0.16, 0.55, 0.64),
  skyHigh: new Color(0.1, 0.29, 0.62),
  skyLow: new Color(0.52, 0.7, 0.84),
};

export function makeWater(stage: Stage, measure: Measure, surfaceHeight: number | null): Scenery {
  const { size } = measure;
  const sun = new Vector3(0.32, 1, 0.22).normalize();
  const uniforms = waterUniforms(COLOURS, sun, SIGHT * size, 1.5 * size);
  const hasSurface = surfaceHeight !== null;
  const highest = surfaceHeight ?? measure.high + SURFACE_ABOVE * size;
  let bedHeight = measure.low - BED_DEPTH * size;
  uniforms.surfaceHeight.value = highest;
  const patch = waterPatch(uniforms);
  const caustics = makeCaustics();
  uniforms.caustics.value = caustics.texture;
  const grain = size < 2 * SMALL_BODY ? 1 : 0.6;
  const bed = makeBed(patch, size, grain);
  const surface = makeSurface(uniforms, hasSurface ? 3 * size : 4 * size, 0.0075, 60 * size);
  const motes = makeMotes(uniforms, 6 * size, 700);
  const shafts = makeShafts(uniforms, size, 46);
  const spray = makeSpray(uniforms, size);
  const dome = makeDome(90 * size, { ...uniforms }, WATER_GLSL, FAR);
  const objects = [bed.object, surface.object, motes.object, shafts.object, spray.object, dome];
  stage.scene.add(...objects);
  stage.reflect(skyAlone({ ...uniforms }, WATER_GLSL, MIRRORED));
  let wasAbove = false;
  let images = 0;
  return {
    atmosphere: {
      sunDirection: sun,
      sunColour: new Color(1, 0.96, 0.88),
      sunIntensity: 3.0,
      shadowRadius: 5,
      environmentIntensity: 0.75,
      exposure: 1.05,
    },
    bodyPatches: [patch],
    get ground() {
      return bedHeight;
    },
    ...(hasSurface ? { waterline: highest } : {}),
    get surface() {
      return uniforms.surfaceHeight.value;
    },
    see(distance: number) {
      clear(uniforms, Math.max(SIGHT * size, distance));
    },
    update(moment: Moment) {
      const low = moment.low - ROOM * size;
      if (low < bedHeight) {
        bedHeight = low;
      }
      if (!hasSurface) {
        uniforms.surfaceHeight.value = Math.max(uniforms.surfaceHeight.value, moment.high + ROOM * size);
      }
      uniforms.causticDrift.value.set(0.011 * moment.time, -0.008 * moment.time);
      if (!stage.isSlow || images++ % 4 === 0) {
        caustics.update(stage.renderer, 0.9 * moment.time);
      }
      bed.update(moment.focus, bedHeight, moment.time);
      surface.update(moment.focus, moment.time);
      motes.update(moment.focus, moment.time);
      shafts.update(moment.focus, moment.time);
      dome.position.copy(stage.camera.position);
      if (hasSurface) {
        const isAbove = moment.high > highest;
        if (isAbove !== wasAbove) {
          const place = new Vector3(moment.focus.x, highest, moment.focus.z);
          surface.ring(place, isAbove ? 0.5 : 0.9);
          spray.burst(place, isAbove ? 0.6 : 1);
        }
        wasAbove = isAbove;
      }
      spray.update(moment.seconds);
    },
    dispose() {
      stage.scene.remove(...objects);
      for (const part of [bed, surface, motes, shafts, spray, caustics]) {
        part.dispose();
      }
      disposeOf(dome);
    },
  };
}

/** The background: water on all sides, or the sky over it. */
const FAR = /* glsl */ `
  sky = waterColour(dir);
  bool isAbove = cameraPosition.y > surfaceHeight;
  if (isAbove) sky = dir.y > 0.0 ? skyColour(dir) : mix(skyLow, sky, smoothstep(-0.01, -0.08, dir.y));`;

/** Reflections on a wet skin: bright water above, dark below, warm sand beneath. */
const MIRRORED = /* glsl */ `
  sky = 1.6 * waterColour(dir) + smoothstep(0.55, 0.95, dir.y) * vec3(1.5, 1.9, 2.0);
  sky += smoothstep(-0.1, -1.0, dir.y) * vec3(0.8, 0.68, 0.45);`;
