// Normals of a surface from two tangents at each node. Tangents are sums over neighbours, so they are linear in the
// amplitudes as nodes are: a mean, and shapes. A normal is their cross product.

import type { Surface } from "./surface";

/** Added to the squares of a node's neighbourhood, over their sum, so that neighbours on one line do no harm. */
const DAMPING = 1e-6;

/** The terms of a node's tangents: its neighbours, relative to the node, times weights [1/m]. */
export interface Neighbourhood {
  readonly neighbours: Uint32Array;
  /** Weights of the tangent across, and of that along: their cross product is the normal. */
  readonly across: Float64Array;
  readonly along: Float64Array;
}

/**
 * Return the neighbourhood of every node. The weights are those of the least-squares linear map from the neighbours'
 * positions in the plane of the mean surface to their moved positions: exact if a neighbourhood is moved by such a map.
 */
export function neighbourhoods({ mean, faces, nodes }: Pick<Surface, "mean" | "faces" | "nodes">): Neighbourhood[] {
  const sets = Array.from({ length: nodes }, () => new Set<number>());
  for (let i = 0; i < faces.length; i += 3) {
    const [a, b, c] = [faces[i]!, faces[i + 1]!, faces[i + 2]!];
    sets[a]!.add(b).add(c);
    sets[b]!.add(c).add(a);
    sets[c]!.add(a).add(b);
  }
  const normals = meanNormals({ mean, faces, nodes });
  return sets.map((set, node) => {
    const [u, v] = plane(normals.subarray(3 * node, 3 * node + 3));
    const neighbours = Uint32Array.from(set);
    const us = new Float64Array(neighbours.length);
    const vs = new Float64Array(neighbours.length);
    neighbours.forEach((other, i) => {
      for (let axis = 0; axis < 3; axis++) {
        const away = mean[3 * other + axis]! - mean[3 * node + axis]!;
        us[i]! += away * u[axis]!;
        vs[i]! += away * v[axis]!;
      }
    });
    return { neighbours, ...leastSquares(us, vs) };
  });
}

/** Return the normals (N, 3) of the mean surface, of length 1. */
export function meanNormals({ mean, faces, nodes }: Pick<Surface, "mean" | "faces" | "nodes">): Float32Array<ArrayBuffer> {
  const normals = new Float32Array(3 * nodes);
  for (let i = 0; i < faces.length; i += 3) {
    const corners = [3 * faces[i]!, 3 * faces[i + 1]!, 3 * faces[i + 2]!];
    const [a, b, c] = corners as [number, number, number];
    const p = [0, 1, 2].map((axis) => mean[b + axis]! - mean[a + axis]!);
    const q = [0, 1, 2].map((axis) => mean[c + axis]! - mean[a + axis]!);
    for (const corner of corners) {
      for (let axis = 0; axis < 3; axis++) {
        const [next, last] = [(axis + 1) % 3, (axis + 2) % 3];
        normals[corner + axis]! += p[next]! * q[last]! - p[last]! * q[next]!;
      }
    }
  }
  for (let i = 0; i < normals.length; i += 3) {
    const length = Math.hypot(normals[i]!, normals[i + 1]!, normals[i + 2]!) || 1;
    for (let axis = 0; axis < 3; axis++) {
      normals[i + axis]! /= length;
    }
  }
  return normals;
}

/** Return two unit vectors perpendicular to a normal, whose cross product is the normal. */
function plane([x, y, z]: ArrayLike<number> & Iterable<number>): [number[], number[]] {
  const [nx, ny, nz] = [x as number, y as number, z as number];
  // Duff et al., Building an Orthonormal Basis, Revisited (2017).
  const sign = nz >= 0 ? 1 : -1;
  const a = -1 / (sign + nz);
  const b = nx * ny * a;
  return [
    [1 + sign * nx * nx * a, sign * b, -sign * nx],
    [b, sign + ny * ny * a, -ny],
  ];
}

function leastSquares(us: Float64Array, vs: Float64Array): Pick<Neighbourhood, "across" | "along"> {
  let [uu, uv, vv] = [0, 0, 0];
  us.forEach((u, i) => {
    uu += u * u;
    uv += u * vs[i]!;
    vv += vs[i]! * vs[i]!;
  });
  const damping = DAMPING * (uu + vv) || 1;
  uu += damping;
  vv += damping;
  const determinant = uu * vv - uv * uv;
  const across = us.map((u, i) => (vv * u - uv * vs[i]!) / determinant);
  const along = us.map((u, i) => (uu * vs[i]! - uv * u) / determinant);
  return { across, along };
}
