// A descent in WebAssembly: J of a motion, its derivatives by the variables, and the motion itself.

import { checkLength, exportedAddress, exportedFunction, Heap, startModule, type ModuleExports } from "../emulator/instance";
import type { DescentFacts, Movable, Values } from "./facts";

/** Prefix of the C names in every descent's module. */
const PREFIX = "descent";

/** J near some z: cost + slope · dz + dz · curvature · dz / 2. */
export interface QuadraticModel {
  readonly cost: number;
  /** Curvature (Z, Z), row by row. */
  readonly curvature: Float32Array;
  /** Slope (Z). */
  readonly slope: Float32Array;
}

/** The emulator's motion under the controls of one z. */
export interface EmulatedMotion {
  /** Controls (T, C). */
  readonly controls: Float32Array;
  /** States (T + 1, S). */
  readonly states: Float32Array;
}

export class DescentModule {
  readonly #heap: Heap;
  readonly #memory: number;
  /** Initial numbers of the objective. */
  readonly #numbers: Float32Array;

  private constructor(
    private readonly exports: ModuleExports,
    readonly facts: DescentFacts,
  ) {
    this.#heap = new Heap(exports);
    this.#memory = this.#heap.room(exportedFunction(exports, `${PREFIX}_room`)());
    this.#numbers = this.#own("numbers", facts.numbers).slice();
  }

  /** Start a compiled module with the bundle's `facts`. */
  static async start(module: WebAssembly.Module, facts: DescentFacts): Promise<DescentModule> {
    return new DescentModule(await startModule(module), facts);
  }

  /** Set the start of motions (S), the moved values, and the defects to add to super steps (T, V), if any. */
  pose(start: ArrayLike<number>, values: Values = {}, defects?: ArrayLike<number>): void {
    const { facts } = this;
    checkLength(start, facts.state, "start");
    const numbers = this.#own("numbers", facts.numbers);
    numbers.set(this.#numbers);
    for (const movable of facts.movable) {
      const value = values[movable.name] ?? movable.value;
      checkLength(value, movable.value.length, movable.name);
      const components = componentsOf(movable, value);
      for (const [entry, component, offset] of movable.at) {
        numbers[entry] = components[component]! + offset;
      }
    }
    const added = this.#own("defects", facts.steps * facts.defect);
    if (defects === undefined) {
      added.fill(0);
    } else {
      checkLength(defects, added.length, "defects");
      added.set(defects);
    }
    this.#within((heap) => this.#call("begin_at", heap.placed(start), this.#memory));
  }

  /** Return J of each of `zs`, each (Z); not finite if the emulator diverges. */
  costs(zs: readonly ArrayLike<number>[]): number[] {
    const { z } = this.facts;
    return this.#within((heap) => {
      const rows = heap.room(z * zs.length);
      zs.forEach((row, i) => heap.view(rows + 4 * z * i, z).set(row));
      // In double precision.
      const costs = heap.room(2 * zs.length);
      this.#call("costs", rows, zs.length, costs, this.#memory);
      return [...new Float64Array(this.exports.memory.buffer, costs, zs.length)];
    });
  }

  /** Return J near `z` (Z). */
  quadraticModel(z: ArrayLike<number>): QuadraticModel {
    const size = this.facts.z;
    checkLength(z, size, "z");
    return this.#within((heap) => {
      const at = heap.placed(z);
      const curvature = heap.room(size * size);
      const slope = heap.room(size);
      const cost = this.#call("quadratic_model", at, curvature, slope, this.#memory);
      return { cost, curvature: heap.view(curvature, size * size).slice(), slope: heap.view(slope, size).slice() };
    });
  }

  /** Return the motion of `z` (Z). */
  motion(z: ArrayLike<number>): EmulatedMotion {
    const { facts } = this;
    checkLength(z, facts.z, "z");
    return this.#within((heap) => {
      const at = heap.placed(z);
      const controls = heap.room(facts.steps * facts.control);
      const latents = heap.room((facts.steps + 1) * facts.latent);
      const states = heap.room((facts.steps + 1) * facts.state);
      this.#call("motion", at, controls, latents, states, this.#memory);
      return {
        controls: heap.view(controls, facts.steps * facts.control).slice(),
        states: heap.view(states, (facts.steps + 1) * facts.state).slice(),
      };
    });
  }

  /** Return the defects (T, V) that make the emulator follow `states` (T + 1, S) of the physics under `controls` (T, C). */
  defectsOf(states: ArrayLike<number>, controls: ArrayLike<number>): Float32Array {
    const { facts } = this;
    checkLength(states, (facts.steps + 1) * facts.state, "states");
    checkLength(controls, facts.steps * facts.control, "controls");
    return this.#within((heap) => {
      const size = facts.steps * facts.defect;
      const [from, held] = [heap.placed(states), heap.placed(controls)];
      const defects = heap.room(size);
      this.#call("defects_of", from, held, defects);
      return heap.view(defects, size).slice();
    });
  }

  #call(name: string, ...numbers: number[]): number {
    return exportedFunction(this.exports, `${PREFIX}_${name}`)(...numbers);
  }

  /** Return one of the module's arrays; get it again after memory has grown. */
  #own(name: string, size: number): Float32Array {
    return this.#heap.view(exportedAddress(this.exports, `${PREFIX}_${name}`), size);
  }

  /** Run `work` with memory that is freed afterwards. */
  #within<T>(work: (heap: Heap) => T): T {
    const before = this.#heap.top;
    try {
      return work(this.#heap);
    } finally {
      this.#heap.top = before;
    }
  }
}

function componentsOf(movable: Movable, value: readonly number[]): readonly number[] {
  if (movable.kind !== "heading") {
    return value;
  }
  const half = value[0]! / 2;
  return [Math.cos(half), Math.sin(half)];
}
