// Policies in WebAssembly: from a state, the phase of a clock and a command to a control; or with clock and command in the state.

import { checkLength, exportedFunction, Heap, startModule, type ModuleExports } from "./instance";

const PREFIX = "policy";

/** Size of a command: forward speed [m/s], and the angles left to turn left, pitch up and roll [rad]. */
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

  /** Start a compiled module from states of `stateSize` numbers to controls of `controlSize`. */
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

/** Result of a policy for a commanded body. */
export interface Commanded {
  /** The control (C), to be held for one super step. */
  readonly control: Float32Array;
  /** The state (S) with the command in it, from which the super step begins. */
  readonly state: Float32Array;
}

/** A policy of a body whose clock and commands are in its state. */
export class CommandedPolicy {
  readonly #heap: Heap;
  readonly #state: number;
  readonly #command: number;
  readonly #control: number;
  readonly #commanded: number;

  private constructor(
    private readonly exports: ModuleExports,
    readonly stateSize: number,
    readonly controlSize: number,
    readonly commandSize: number,
  ) {
    this.#heap = new Heap(exports);
    this.#state = this.#heap.room(stateSize);
    this.#command = this.#heap.room(commandSize);
    this.#control = this.#heap.room(controlSize);
    this.#commanded = this.#heap.room(stateSize);
  }

  /** Start a compiled module from states and commands to controls, of these sizes. */
  static async start(module: WebAssembly.Module, stateSize: number, controlSize: number, commandSize: number): Promise<CommandedPolicy> {
    return new CommandedPolicy(await startModule(module), stateSize, controlSize, commandSize);
  }

  /** Return the policy's result for a body in `state` (S) under `command`, in the bundle's order of numbers. */
  control(state: ArrayLike<number>, command: ArrayLike<number>): Commanded {
    checkLength(state, this.stateSize, "state");
    checkLength(command, this.commandSize, "command");
    const heap = this.#heap;
    heap.view(this.#state, this.stateSize).set(state);
    heap.view(this.#command, this.commandSize).set(command);
    exportedFunction(this.exports, `${PREFIX}_control`)(this.#state, this.#command, this.#control, this.#commanded);
    return {
      control: heap.view(this.#control, this.controlSize).slice(),
      state: heap.view(this.#commanded, this.stateSize).slice(),
    };
  }
}
