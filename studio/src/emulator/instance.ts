// Starting a WebAssembly module of this project, which imports nothing and has its own memory.

import { fetchOwn } from "../server/token";

const ALIGNMENT = 64;
const PAGE = 65536;

/** Exports of every module, besides the functions that begin with its name. */
export interface ModuleExports {
  readonly memory: WebAssembly.Memory;
  readonly [name: string]: WebAssembly.ExportValue;
}

/** Fetch a module; the error names the missing file and the reason. */
export async function fetchModule(address: string | URL): Promise<WebAssembly.Module> {
  const response = await fetchOwn(address);
  const bytes = await response.arrayBuffer();
  return WebAssembly.compile(bytes);
}

/** Start a module and return its exports. */
export async function startModule(module: WebAssembly.Module): Promise<ModuleExports> {
  const instance = await WebAssembly.instantiate(module, {});
  const exports = instance.exports as unknown as ModuleExports;
  const initialise = exports["_initialize"];
  if (typeof initialise === "function") {
    initialise();
  }
  return exports;
}

/** Return the exported function `name`; an error names what the module lacks. */
export function exportedFunction(exports: ModuleExports, name: string): (...numbers: number[]) => number {
  const found = exports[name];
  if (typeof found !== "function") {
    throw new Error(`the module has no function '${name}'`);
  }
  return found as (...numbers: number[]) => number;
}

/** Return the address that the exported global `name` holds. */
export function exportedAddress(exports: ModuleExports, name: string): number {
  const found = exports[name];
  if (!(found instanceof WebAssembly.Global)) {
    throw new Error(`the module has no address '${name}'`);
  }
  return Number(found.value);
}

/** A stack of memory for numbers, above what the module itself uses. */
export class Heap {
  #top: number;

  constructor(private readonly exports: ModuleExports) {
    this.#top = exportedAddress(exports, "__heap_base");
  }

  /** Top of the stack; set it back to free memory. */
  get top(): number {
    return this.#top;
  }

  set top(address: number) {
    this.#top = address;
  }

  /** Return the address of new space for `size` floats. */
  room(size: number): number {
    const address = Math.ceil(this.#top / ALIGNMENT) * ALIGNMENT;
    this.#top = address + 4 * size;
    const missing = this.#top - this.exports.memory.buffer.byteLength;
    if (missing > 0) {
      this.exports.memory.grow(Math.ceil(missing / PAGE));
    }
    return address;
  }

  /** Return the address of a copy of `numbers`. */
  placed(numbers: ArrayLike<number>): number {
    const address = this.room(numbers.length);
    this.view(address, numbers.length).set(numbers);
    return address;
  }

  /** Return the floats at an address; memory that grows makes old views empty, so get them anew. */
  view(address: number, size: number): Float32Array {
    return new Float32Array(this.exports.memory.buffer, address, size);
  }
}

/** Throw a RangeError unless the number of numbers is as wanted. */
export function checkLength(numbers: ArrayLike<number>, wanted: number, name: string): void {
  if (numbers.length !== wanted) {
    throw new RangeError(`${name}: wanted ${wanted} numbers, got ${numbers.length}`);
  }
}
