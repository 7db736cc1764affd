// Another body of a family: the change of a state for another value of a parameter.

import { rootPose } from "../body/root";
import type { Bundle, ParameterFacts } from "../bundle/bundle";

/** Return the change (S) of `state` for which its parameter is `value`: mass points move as they would at rest. */
export function reshape(facts: Bundle, state: Float32Array, parameter: ParameterFacts, value: number): Float32Array {
  const change = new Float32Array(state.length);
  const by = value - state[parameter.entry]!;
  change[parameter.entry] = by;
  if (!facts.root || parameter.growth.length === 0) {
    return change;
  }
  const { forward, left, up } = rootPose(facts.root, state);
  parameter.growth.forEach(([x, y, z], point) => {
    for (let axis = 0; axis < 3; axis++) {
      change[3 * point + axis] = by * (x * forward[axis]! + y * left[axis]! + z * up[axis]!);
    }
  });
  return change;
}
