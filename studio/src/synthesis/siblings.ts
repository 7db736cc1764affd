// Other results beside the shown one: their bodies at the same time, as shadows of one colour.

import { emptyPose, poseBones, type Pose } from "../body/pose";
import type { Bundle } from "../bundle/bundle";
import { makeGhost, type BodyView } from "../scene/body/body";
import { TARGET_COLOUR } from "../scene/handle";
import type { World } from "../scene/world";
import type { Result } from "./result";

export class Siblings {
  readonly #bodies: BodyView[] = [];
  readonly #pose: Pose;
  readonly #state: Float32Array;
  #results: readonly Result[] = [];

  constructor(
    private readonly facts: Bundle,
    private readonly world: World,
  ) {
    this.#pose = emptyPose(facts.skeleton.length);
    this.#state = new Float32Array(facts.rest.length);
  }

  /** Show these beside the body; none hides all. */
  show(results: readonly Result[]): void {
    this.#results = results;
    while (this.#bodies.length < results.length) {
      const body = makeGhost(this.facts, this.world.size, TARGET_COLOUR);
      this.world.add(body.object);
      this.#bodies.push(body);
    }
    this.#bodies.forEach((body, i) => (body.object.visible = i < results.length));
  }

  /** Pose them at `time` [s]. */
  update(time: number): void {
    this.#results.forEach((result, i) => {
      result.motion.sample(time, this.#state);
      poseBones(this.facts.skeleton, this.#state, this.#pose);
      this.#bodies[i]!.update(this.#pose, this.#state);
    });
  }

  dispose(): void {
    for (const body of this.#bodies) {
      this.world.remove(body.object);
      body.dispose();
    }
  }
}
