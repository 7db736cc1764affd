// A body's physics in WebAssembly (physics/deformable/native/mass_spring_calls.c).

import { exportedFunction, Heap, startModule, type ModuleExports } from "../emulator/instance";

/** Prefix of the C names in every such module. */
const PREFIX = "physics";

/** Scheme: that of the truth, or a user's. */
export type Way = "rollout" | "rollout_usual";

export class PhysicsModule {
  readonly #heap: Heap;

  private constructor(
    private readonly exports: ModuleExports,
    readonly stateSize: number,
    readonly controlSize: number,
  ) {
    this.#heap = new Heap(exports);
  }

  /** Start a compiled module of a body with these sizes of a state and a control. */
  static async start(module: WebAssembly.Module, stateSize: number, controlSize: number): Promise<PhysicsModule> {
    return new PhysicsModule(await startModule(module), stateSize, controlSize);
  }

  /** Return the states (T, S) after each of `controls` (T, C), from the state `from` (S). */
  play(way: Way, from: ArrayLike<number>, controls: Float32Array): Float32Array {
    const heap = this.#heap;
    const before = heap.top;
    const steps = controls.length / this.controlSize;
    const [state, held] = [heap.placed(from), heap.placed(controls)];
    const room = heap.room((steps + 1) * this.stateSize);
    exportedFunction(this.exports, `${PREFIX}_${way}`)(state, held, steps, room);
    const states = heap.view(room, (steps + 1) * this.stateSize).slice(this.stateSize);
    heap.top = before;
    return states;
  }
}
