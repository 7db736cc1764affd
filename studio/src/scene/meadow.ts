// A meadow on a clear day: grass with daisies, a wood at its edge, and distant hills.

import { Color, Group, Mesh, MeshStandardMaterial, Vector3 } from "three";
import { disposeOf } from "./dispose";
import { patchMaterial, type Patch } from "./glsl";
import { hazePatch, HILLS, makeTrees, SUN } from "./lot";
import type { Measure, Moment, Scenery } from "./scenery";
import { DAY_DECLARATIONS, dayUniforms, makeDome, skyAlone } from "./sky";
import type { Stage } from "./stage";
import { horizonGeometry } from "./water/surface";

/** Half the side of the grass [m]. */
const MEADOW = 420;

/** Distance of the wood [m]: so far away that it may move along with a walker. */
const WOOD = 75;

/** Depth of the ground under a hanging body, over its size. */
const GROUND_DEPTH = 0.08;

export function makeMeadow(stage: Stage, measure: Measure, groundHeight: number | null, sun: Vector3 = SUN): Scenery {
  const ground = groundHeight ?? measure.low - GROUND_DEPTH * measure.size;
  const haze = hazePatch();
  const dome = makeDome(900, dayUniforms(sun), DAY_DECLARATIONS, HILLS);
  const around = new Group();
  around.name = "meadow";
  around.add(makeGrass(haze), makeTrees(haze, WOOD));
  stage.scene.add(dome, around);
  stage.reflect(skyAlone(dayUniforms(sun), DAY_DECLARATIONS, "sky = dir.y > 0.0 ? daySky(dir) : vec3(0.12, 0.17, 0.06);"));
  return {
    atmosphere: {
      sunDirection: sun,
      sunColour: new Color(1, 0.94, 0.84),
      sunIntensity: 3.6,
      shadowRadius: 4,
      environmentIntensity: 0.85,
      exposure: 1,
    },
    bodyPatches: [],
    ground,
    update(moment: Moment) {
      dome.position.copy(stage.camera.position);
      around.position.set(moment.focus.x, ground, moment.focus.z);
    },
    dispose() {
      stage.scene.remove(dome, around);
      dome.traverse(disposeOf);
      around.traverse(disposeOf);
    },
  };
}

function makeGrass(haze: Patch): Mesh {
  const grass: Patch = {
    key: "grass",
    uniforms: {},
    colour: `
      vec2 onGrass = vPlace.xz;
      float closeBy = exp(-length(vViewPosition) / 7.0);
      float nearBy = exp(-length(vViewPosition) / 40.0);
      float blades = mix(0.5, noise2(onGrass * vec2(70.0, 40.0)), closeBy);
      float tufts = mix(0.5, noise2(onGrass * 7.0), nearBy);
      float broad = fbm2(onGrass * 0.11);
      diffuseColor.rgb = mix(vec3(0.075, 0.15, 0.03), vec3(0.19, 0.24, 0.06), broad);
      diffuseColor.rgb *= (0.7 + 0.6 * tufts) * (0.65 + 0.7 * blades);
      vec2 cell = floor(onGrass * 3.0);
      vec2 middle = 0.3 + 0.4 * vec2(noise2(cell * 7.3 + 1.7), noise2(cell * 9.1 + 5.2));
      float away = length(fract(onGrass * 3.0) - middle);
      float grows = step(0.62, noise2(cell * 3.7)) * nearBy;
      diffuseColor.rgb = mix(diffuseColor.rgb, vec3(0.85, 0.85, 0.8), grows * smoothstep(0.085, 0.05, away));
      diffuseColor.rgb = mix(diffuseColor.rgb, vec3(0.8, 0.55, 0.05), grows * smoothstep(0.035, 0.02, away));`,
  };
  const material = patchMaterial(new MeshStandardMaterial({ color: 0xffffff, roughness: 1 }), [grass, haze]);
  const mesh = new Mesh(horizonGeometry(MEADOW), material);
  mesh.receiveShadow = true;
  mesh.frustumCulled = false;
  return mesh;
}
