// The surface of a soft body: a mean and shapes, of which a state holds the amplitudes (appearance/shapes.py).

import { floatsOf, int16Of, uint32Of } from "../bundle/base64";
import type { SurfaceArrays, Vector3 } from "../bundle/bundle";

export interface Surface {
  /** (N, 3) [m] */
  readonly mean: Float32Array<ArrayBuffer>;
  /** (K, N, 3), in units of `scales`. */
  readonly modes: Int16Array<ArrayBuffer>;
  readonly scales: Float32Array<ArrayBuffer>;
  /** (F, 3) */
  readonly faces: Uint32Array<ArrayBuffer>;
  readonly first: number;
  readonly anchor: number;
  readonly nodes: number;
  readonly shapes: number;
}

/** A box [m]. */
export interface Box {
  readonly low: Vector3;
  readonly high: Vector3;
}

const known = new WeakMap<SurfaceArrays, Surface>();

/** Return the surface that a bundle describes, the same one every time; an error names what does not fit together. */
export function surfaceOf(arrays: SurfaceArrays): Surface {
  const surface = known.get(arrays) ?? readSurface(arrays);
  known.set(arrays, surface);
  return surface;
}

function readSurface(arrays: SurfaceArrays): Surface {
  const mean = floatsOf(arrays.mean);
  const modes = int16Of(arrays.modes);
  const scales = floatsOf(arrays.scales);
  const faces = uint32Of(arrays.faces);
  const nodes = mean.length / 3;
  const shapes = scales.length;
  if (modes.length !== 3 * shapes * nodes) {
    throw new Error(`surface: wanted ${3 * shapes * nodes} numbers of modes, came ${modes.length}`);
  }
  if (faces.some((node) => node >= nodes)) {
    throw new Error("surface: a face has a node that is not there");
  }
  return { mean, modes, scales, faces, first: arrays.first, anchor: arrays.anchor, nodes, shapes };
}

/** Return where the frame is that all nodes go with [m]: its origin, in the world's axes. */
export function surfaceOrigin(surface: Pick<Surface, "anchor">, state: ArrayLike<number>): [number, number, number] {
  const { anchor } = surface;
  return anchor < 0 ? [0, 0, 0] : [state[anchor]!, state[anchor + 1]!, state[anchor + 2]!];
}

/** Return the box around the nodes with every amplitude zero, in their own frame. */
export function surfaceBox({ mean }: Pick<Surface, "mean">): Box {
  const low: [number, number, number] = [Infinity, Infinity, Infinity];
  const high: [number, number, number] = [-Infinity, -Infinity, -Infinity];
  mean.forEach((value, i) => {
    low[i % 3] = Math.min(low[i % 3]!, value);
    high[i % 3] = Math.max(high[i % 3]!, value);
  });
  return { low, high };
}

/** Return the heading [rad] of the level direction in which the nodes lie least far apart: whence a cloth shows its face. */
export function facing({ mean, nodes }: Pick<Surface, "mean" | "nodes">): number {
  let [x, y, xx, xy, yy] = [0, 0, 0, 0, 0];
  for (let i = 0; i < nodes; i++) {
    x += mean[3 * i]! / nodes;
    y += mean[3 * i + 1]! / nodes;
  }
  for (let i = 0; i < nodes; i++) {
    const [dx, dy] = [mean[3 * i]! - x, mean[3 * i + 1]! - y];
    xx += dx * dx;
    xy += dx * dy;
    yy += dy * dy;
  }
  return Math.atan2(2 * xy, xx - yy) / 2 - Math.PI / 2;
}

/** Return the root mean square distance [m] of the nodes of two states: modes are orthogonal, of root mean square 1 a node. */
export function surfaceGap(surface: Pick<Surface, "first" | "shapes" | "anchor">, one: ArrayLike<number>, other: ArrayLike<number>): number {
  let square = 0;
  for (let i = surface.first; i < surface.first + surface.shapes; i++) {
    square += (one[i]! - other[i]!) ** 2;
  }
  const [a, b] = [surfaceOrigin(surface, one), surfaceOrigin(surface, other)];
  return Math.hypot(Math.sqrt(square), a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

/** Return the nodes that no shape moves: those that the anchor holds. */
export function heldNodes({ modes, nodes, shapes }: Pick<Surface, "modes" | "nodes" | "shapes">): number[] {
  const isHeld = (node: number): boolean => {
    for (let shape = 0; shape < shapes; shape++) {
      const first = 3 * (shape * nodes + node);
      if (modes[first] !== 0 || modes[first + 1] !== 0 || modes[first + 2] !== 0) {
        return false;
      }
    }
    return true;
  };
  return Array.from({ length: nodes }, (_, node) => node).filter(isHeld);
}
