// The surface of a soft body: a mean and shapes, whose amplitudes a state holds (appearance/shapes.py).

import { floatsOf, int16Of, uint32Of } from "../bundle/base64";
import type { Placement, SurfaceArrays, Vector3 } from "../bundle/bundle";
import { normalised, rotate } from "./quaternion";

export interface Surface {
  /** Mean positions (N, 3) [m]. */
  readonly mean: Float32Array<ArrayBuffer>;
  /** Shapes (K, N, 3), in units of `scales`. */
  readonly modes: Int16Array<ArrayBuffer>;
  readonly scales: Float32Array<ArrayBuffer>;
  /** Corners of the triangles (F, 3). */
  readonly faces: Uint32Array<ArrayBuffer>;
  readonly first: number;
  readonly placement: Placement;
  readonly nodes: number;
  readonly shapes: number;
  /** Colours of the nodes (N, 3), sRGB; null if all are alike. */
  readonly colours: Float32Array<ArrayBuffer> | null;
  /** The box around the nodes at zero amplitudes, in their own frame. */
  readonly box: Box;
}

/** A box [m]. */
export interface Box {
  readonly low: Vector3;
  readonly high: Vector3;
}

const known = new WeakMap<SurfaceArrays, Surface>();

/** Return the surface that a bundle describes, the same object every time; an error names an inconsistency. */
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
    throw new Error(`surface: wanted ${3 * shapes * nodes} numbers of modes, got ${modes.length}`);
  }
  if (faces.some((node) => node >= nodes)) {
    throw new Error("surface: a face names a node that does not exist");
  }
  const colours = arrays.colours ? floatsOf(arrays.colours) : null;
  return { mean, modes, scales, faces, colours, first: arrays.first, placement: arrays.placement, nodes, shapes, box: boxOf(mean) };
}

/** Pose of a frame: its origin in the world [m], and the quaternion from it to the world. */
export interface Frame {
  readonly origin: [number, number, number];
  readonly turn: number[];
}

/** Return the frame with which all nodes move and turn in a state. */
export function surfaceFrame({ placement }: Pick<Surface, "placement">, state: ArrayLike<number>): Frame {
  const { position: p, heading, orientation: q } = placement;
  const origin: [number, number, number] = p < 0 ? [0, 0, 0] : [state[p]!, state[p + 1]!, state[p + 2]!];
  if (q >= 0) {
    return { origin, turn: normalised([state[q]!, state[q + 1]!, state[q + 2]!, state[q + 3]!]) };
  }
  const half = heading < 0 ? 0 : state[heading]! / 2;
  return { origin, turn: [Math.cos(half), 0, 0, Math.sin(half)] };
}

/** Return the world position of a point of a frame [m]. */
export function inWorld({ origin, turn }: Frame, point: ArrayLike<number>): [number, number, number] {
  const [x, y, z] = rotate(turn, point);
  return [origin[0] + x!, origin[1] + y!, origin[2] + z!];
}

function boxOf(mean: Float32Array): Box {
  const low: [number, number, number] = [Infinity, Infinity, Infinity];
  const high: [number, number, number] = [-Infinity, -Infinity, -Infinity];
  mean.forEach((value, i) => {
    low[i % 3] = Math.min(low[i % 3]!, value);
    high[i % 3] = Math.max(high[i % 3]!, value);
  });
  return { low, high };
}

/** Return the heading [rad] of the level direction of the nodes' smallest extent, from which a cloth shows its face. */
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

/**
 * Return the root mean square distance [m] of the nodes of two states: modes are orthogonal, of root mean square 1 a node.
 * The distance of their frames is measured at the corners of the surface's box.
 */
export function surfaceGap(surface: Surface, one: ArrayLike<number>, other: ArrayLike<number>): number {
  let square = 0;
  for (let i = surface.first; i < surface.first + surface.shapes; i++) {
    square += (one[i]! - other[i]!) ** 2;
  }
  const [a, b] = [surfaceFrame(surface, one), surfaceFrame(surface, other)];
  for (const corner of cornersOf(surface.box)) {
    const [from, to] = [inWorld(a, corner), inWorld(b, corner)];
    square += from.reduce((sum, value, axis) => sum + (value - to[axis]!) ** 2, 0) / 8;
  }
  return Math.sqrt(square);
}

/** Return the eight corners of a box. */
export function cornersOf({ low, high }: Box): number[][] {
  return Array.from({ length: 8 }, (_, corner) => [0, 1, 2].map((axis) => ((corner >> axis) % 2 === 0 ? low : high)[axis]!));
}

/** Return whether a surface is closed, with two triangles at each edge: a solid, not a cloth. */
export function isClosed({ faces, nodes }: Pick<Surface, "faces" | "nodes">): boolean {
  const open = new Set<number>();
  for (let i = 0; i < faces.length; i += 3) {
    for (let corner = 0; corner < 3; corner++) {
      const [a, b] = [faces[i + corner]!, faces[i + ((corner + 1) % 3)]!];
      const edge = Math.min(a, b) * nodes + Math.max(a, b);
      if (!open.delete(edge)) {
        open.add(edge);
      }
    }
  }
  return open.size === 0;
}

/** Return the nodes that no shape moves, held by the anchor. */
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
