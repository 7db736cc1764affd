// A surface for the graphics card: a texture of integers with a block of texels for every node.
//
//   node: G groups of 4 shapes, each 3 texels (x, y and z of the 4 shapes); then G groups, each 6 texels of tangents
//
// A texel times the 4 weights of its group is a part of a node's position, or of a tangent; a weight is an amplitude times
// the scale of its shape.

import type { Surface } from "./surface";
import { neighbourhoods, type Neighbourhood } from "./tangents";

/** Number of shapes in a group, which is that of a texel's numbers. */
export const GROUP = 4;

/** Number of texels of a group: x, y, z of the displacement, of the tangent across, and of that along. */
export const ROWS = 9;

/** Largest texture size that every machine supports [texels along a side]. */
const MAX_SIDE = 4096;

/** Largest signed 16-bit integer. */
const LARGEST = 2 ** 15 - 1;

export interface PackedSurface {
  readonly texels: Int16Array<ArrayBuffer>;
  readonly width: number;
  readonly height: number;
  /** Number of groups of shapes drawn: all, or as many of the first ones as fit. */
  readonly groups: number;
  readonly nodesPerRow: number;
  /** Unit of the tangents in the texture, unlike displacements [1/m]. */
  readonly tangentScale: number;
  /** Tangents of the mean surface (N, 3). */
  readonly across: Float32Array<ArrayBuffer>;
  readonly along: Float32Array<ArrayBuffer>;
}

const known = new WeakMap<Surface, PackedSurface>();

/** Return the surface packed for textures, the same object every time. */
export function packedOf(surface: Surface): PackedSurface {
  const packed = known.get(surface) ?? packSurface(surface);
  known.set(surface, packed);
  return packed;
}

function packSurface(surface: Surface): PackedSurface {
  const { nodes } = surface;
  const groups = groupsWithRoom(nodes, Math.ceil(surface.shapes / GROUP));
  const block = ROWS * groups;
  const nodesPerRow = Math.min(Math.floor(MAX_SIDE / block), nodes);
  const width = block * nodesPerRow;
  const height = Math.ceil(nodes / nodesPerRow);
  const around = neighbourhoods(surface);
  const tangentScale = largestTangent(surface, around, groups) / LARGEST || 1;
  const texels = new Int16Array(4 * width * height);
  const across = new Float32Array(3 * nodes);
  const along = new Float32Array(3 * nodes);
  for (let node = 0; node < nodes; node++) {
    const start = 4 * (Math.floor(node / nodesPerRow) * width + (node % nodesPerRow) * block);
    for (let shape = 0; shape < Math.min(GROUP * groups, surface.shapes); shape++) {
      const group = Math.floor(shape / GROUP);
      const place = start + 4 * 3 * group + (shape % GROUP);
      const tangentPlace = start + 4 * (3 * groups + 6 * group) + (shape % GROUP);
      const mode = surface.modes.subarray(3 * shape * nodes, 3 * (shape + 1) * nodes);
      const tangents = tangentsOf(mode, node, around[node]!);
      for (let axis = 0; axis < 3; axis++) {
        texels[place + 4 * axis] = mode[3 * node + axis]!;
      }
      tangents.forEach((value, row) => (texels[tangentPlace + 4 * row] = Math.round(value / tangentScale)));
    }
    const tangents = tangentsOf(surface.mean, node, around[node]!);
    across.set(tangents.slice(0, 3), 3 * node);
    along.set(tangents.slice(3), 3 * node);
  }
  return { texels, width, height, groups, nodesPerRow, tangentScale, across, along };
}

/** Write the weights of a state to `out`, from `first` on. */
export function writeWeights(surface: Surface, state: ArrayLike<number>, out: Float32Array, first: number, groups: number): void {
  const count = Math.min(GROUP * groups, surface.shapes);
  for (let shape = 0; shape < count; shape++) {
    out[first + shape] = state[surface.first + shape]! * surface.scales[shape]!;
  }
}

/** Return the number of groups that fit into a texture, at most `wanted`: the last shapes are the finest wrinkles. */
export function groupsWithRoom(nodes: number, wanted: number): number {
  let groups = wanted;
  while (groups > 1 && Math.ceil(nodes / Math.floor(MAX_SIDE / (ROWS * groups))) > MAX_SIDE) {
    groups -= 1;
  }
  return groups;
}

function largestTangent(surface: Surface, around: readonly Neighbourhood[], groups: number): number {
  const { nodes } = surface;
  let largest = 0;
  for (let shape = 0; shape < Math.min(GROUP * groups, surface.shapes); shape++) {
    const mode = surface.modes.subarray(3 * shape * nodes, 3 * (shape + 1) * nodes);
    for (let node = 0; node < nodes; node++) {
      for (const value of tangentsOf(mode, node, around[node]!)) {
        largest = Math.max(largest, Math.abs(value));
      }
    }
  }
  return largest;
}

const tangents = new Float64Array(6);

/** Return the tangents across and along, as a view that the next call changes, of `positions` (N, 3) at a node. */
function tangentsOf(positions: ArrayLike<number>, node: number, { neighbours, across, along }: Neighbourhood): Float64Array {
  tangents.fill(0);
  for (let i = 0; i < neighbours.length; i++) {
    const other = 3 * neighbours[i]!;
    for (let axis = 0; axis < 3; axis++) {
      const away = positions[other + axis]! - positions[3 * node + axis]!;
      tangents[axis]! += across[i]! * away;
      tangents[3 + axis]! += along[i]! * away;
    }
  }
  return tangents;
}
