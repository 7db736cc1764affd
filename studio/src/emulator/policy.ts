// A policy in WebAssembly: from a state, the phase of a clock and a command to a control.

import { checkLength, exportedFunction, Heap, startModule, type ModuleExports } from "./instance";

const PREFIX = "policy";

/** Numbers in a command: forward speed [m/s], and how far still to turn left, to pitch up and to roll [rad]. */
export const COMMAND_SIZE = 4;

export class Policy {
  readonly #heap: Heap;
  readonly #state: number;
  readonly #command: number;
  readonly #control: number;

  private constructor(
    private readonly exports: ModuleExports,
    readonly stateSize: number,
    readonly controlSize: number,
  ) {
    this.#heap = new Heap(exports);
    this.#state = this.#heap.room(stateSize);
    this.#command = this.#heap.room(COMMAND_SIZE);
    this.#control = this.#heap.room(controlSize);
  }

  /** Start a compiled module that reads states of `stateSize` numbers and gives controls of `controlSize`. */
  static async start(module: WebAssembly.Module, stateSize: number, controlSize: number): Promise<Policy> {
    return new Policy(await startModule(module), stateSize, controlSize);
  }

  /** Write the control (C) of a body to `out`, as `control` returns it: for many bodies, without new arrays. */
  controlInto(state: Float32Array, phase: number, command: ArrayLike<number>, out: Float32Array): void {
    const heap = this.#heap;
    heap.view(this.#state, this.stateSize).set(state);
    heap.view(this.#command, COMMAND_SIZE).set(command);
    exportedFunction(this.exports, `${PREFIX}_control`)(this.#state, phase, this.#command, this.#control);
    out.set(heap.view(this.#control, this.controlSize));
  }

  /** Return the control (C), to be held for one super step, of a body in `state` (S) at `phase` [rad] under `command`. */
  control(state: ArrayLike<number>, phase: number, command: ArrayLike<number>): Float32Array {
    checkLength(state, this.stateSize, "state");
    checkLength(command, COMMAND_SIZE, "command");
    const heap = this.#heap;
    heap.view(this.#state, this.stateSize).set(state);
    heap.view(this.#command, COMMAND_SIZE).set(command);
    exportedFunction(this.exports, `${PREFIX}_control`)(this.#state, phase, this.#command, this.#control);
    return heap.view(this.#control, this.controlSize).slice();
  }
}
