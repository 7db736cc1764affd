// The drawn school of soft bodies: all in one draw call, whose nodes the vertex shader composes of the shapes.

import { emptyPose } from "../body/pose";
import type { Bundle } from "../bundle/bundle";
import { interpolateHermite } from "../motion/interpolate";
import type { School } from "../steering/school";
import { clothKind, surfaceColour } from "./body/body";
import { makeCloth } from "./body/cloth";
import { surfaceMaterial } from "./body/materials";
import type { Patch } from "./glsl";
import type { SchoolView } from "./school";

/** Return the swimmers of a school, each `size` [m] long. */
export function makeFleshSchool(facts: Bundle, school: School, size: number, patches: readonly Patch[]): SchoolView {
  const kind = clothKind(facts, size);
  const colour = surfaceColour(facts.surface!);
  const cloth = makeCloth(kind, school.count, {
    surface: (nodes) => surfaceMaterial(kind.surface, colour, size, [nodes, ...patches]),
    fittings: null,
  });
  cloth.object.name = "school";
  const state = new Float32Array(facts.rest.length);
  const stateOf = (states: Float32Array, body: number): Float32Array => states.subarray(body * state.length, (body + 1) * state.length);
  const pose = emptyPose(facts.skeleton.length);
  return {
    object: cloth.object,
    update() {
      for (const { batch, before, first, waited } of school.groups) {
        for (let body = 0; body < batch.count; body++) {
          interpolateHermite(stateOf(before, body), stateOf(batch.states, body), waited / facts.dt, facts.dt, facts, state);
          cloth.show(first + body, state, pose);
        }
      }
    },
    dispose: () => cloth.dispose(),
  };
}
