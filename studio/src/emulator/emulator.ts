// An emulator in WebAssembly: one super step, rollouts, trust and batches of bodies.

import { checkLength, exportedAddress, exportedFunction, Heap, startModule, type ModuleExports } from "./instance";

/** Prefix of the C names in every emulator's module. */
const PREFIX = "emulator";

/** Sizes of a module's inputs and outputs. */
export interface EmulatorSizes {
  readonly state: number;
  readonly control: number;
  /** Size of a latent state, which super steps advance. */
  readonly latent: number;
}

/** A super step and its trust score. */
export interface TrustedStep {
  /** The state (S) after it. */
  readonly next: Float32Array;
  /** Distance of its start and control from the training data: 1 is the edge. */
  readonly score: number;
}

/** Bodies that the module keeps, sixteen of them computed side by side. */
export interface Batch {
  readonly count: number;
  /** States (count, S) in the module's memory; get it anew after `advance`. Call `encode` after writing to it. */
  readonly states: Float32Array;
  /** Controls (count, C) in the module's memory, to be written to. */
  readonly controls: Float32Array;
  /** Go on from the `states` written. */
  encode(): void;
  /** Take every body one super step further. */
  advance(): void;
}

export class Emulator {
  readonly #heap: Heap;

  private constructor(
    private readonly exports: ModuleExports,
    readonly sizes: EmulatorSizes,
  ) {
    this.#heap = new Heap(exports);
  }

  /** Start a compiled module. */
  static async start(module: WebAssembly.Module, sizes: EmulatorSizes): Promise<Emulator> {
    return new Emulator(await startModule(module), sizes);
  }

  /** A state (S) to start from, as a new array. */
  get rest(): Float32Array {
    const address = exportedAddress(this.exports, `${PREFIX}_rest`);
    return this.#heap.view(address, this.sizes.state).slice();
  }

  /** Return the state (S) one super step after `state` (S) under `control` (C). */
  step(state: ArrayLike<number>, control: ArrayLike<number>): Float32Array {
    checkLength(state, this.sizes.state, "state");
    checkLength(control, this.sizes.control, "control");
    const [next] = this.#call("step", [state, control], [this.sizes.state]);
    return next!;
  }

  /** Return states (steps + 1, S), `state` included, under `controls` (steps, C). */
  rollout(state: ArrayLike<number>, controls: ArrayLike<number>): Float32Array {
    const steps = Math.floor(controls.length / this.sizes.control);
    checkLength(state, this.sizes.state, "state");
    checkLength(controls, steps * this.sizes.control, "controls");
    const [states] = this.#call("rollout", [state, controls], [(steps + 1) * this.sizes.state], steps);
    return states!;
  }

  /** Return `step` and its score. A module of true physics has none: 0. */
  stepTrusted(state: ArrayLike<number>, control: ArrayLike<number>): TrustedStep {
    if (!(`${PREFIX}_step_trusted` in this.exports)) {
      return { next: this.step(state, control), score: 0 };
    }
    checkLength(state, this.sizes.state, "state");
    checkLength(control, this.sizes.control, "control");
    const before = this.#heap.top;
    const stepTrusted = exportedFunction(this.exports, `${PREFIX}_step_trusted`);
    const address = this.#heap.room(this.sizes.state);
    const score = stepTrusted(this.#heap.placed(state), this.#heap.placed(control), address);
    const next = this.#heap.view(address, this.sizes.state).slice();
    this.#heap.top = before;
    return { next, score };
  }

  /** Return `count` bodies at rest, which the module never frees. */
  batch(count: number): Batch {
    if (!Number.isInteger(count) || count < 1) {
      throw new RangeError(`count: wanted a whole number of 1 or more, got ${count}`);
    }
    const heap = this.#heap;
    const stateSize = this.sizes.state;
    const controlSize = this.sizes.control;
    const latentSize = this.sizes.latent;
    const states = heap.room(count * stateSize);
    const controls = heap.room(count * controlSize);
    const latents = heap.room(count * latentSize);
    const encodeOne = exportedFunction(this.exports, `${PREFIX}_encode`);
    const advanceAll = exportedFunction(this.exports, `${PREFIX}_advance_batch`);
    const encode = (): void => {
      for (let body = 0; body < count; body++) {
        encodeOne(states + 4 * stateSize * body, latents + 4 * latentSize * body);
      }
    };
    const rest = this.rest;
    for (let body = 0; body < count; body++) {
      heap.view(states, count * stateSize).set(rest, body * stateSize);
    }
    encode();
    return {
      count,
      get states() {
        return heap.view(states, count * stateSize);
      },
      get controls() {
        return heap.view(controls, count * controlSize);
      },
      encode,
      advance: () => void advanceAll(latents, controls, count, states),
    };
  }

  // Calls a function of (inputs, counts, outputs) and returns copies of the outputs.
  #call(
    name: string,
    inputs: ArrayLike<number>[],
    outputSizes: number[],
    ...counts: number[]
  ): Float32Array[] {
    const heap = this.#heap;
    const before = heap.top;
    const from = inputs.map((numbers) => heap.placed(numbers));
    const to = outputSizes.map((size) => heap.room(size));
    exportedFunction(this.exports, `${PREFIX}_${name}`)(...from, ...counts, ...to);
    const outputs = to.map((address, i) => heap.view(address, outputSizes[i]!).slice());
    heap.top = before;
    return outputs;
  }
}
