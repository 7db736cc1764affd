// A surface as the vertex shader reads it: texels times weights are where Python has nodes and their normals.

import { describe, expect, test } from "vitest";
import { GROUP, groupsWithRoom, packedOf, ROWS, writeWeights, type PackedSurface } from "../src/body/packing";
import { facing, heldNodes, inWorld, isClosed, surfaceFrame, surfaceGap, surfaceOf, type Surface } from "../src/body/surface";
import type { SurfaceArrays } from "../src/bundle/bundle";
import vectors from "./vectors/surface.json";

const surface = surfaceOf(vectors.surface as unknown as SurfaceArrays);

/** What the shader sums for row `row` of a node. */
function sum(packed: PackedSurface, weights: Float32Array, node: number, row: number): number {
  const { groups, nodesPerRow, width, texels } = packed;
  const start = Math.floor(node / nodesPerRow) * width + (node % nodesPerRow) * ROWS * groups;
  let total = 0;
  for (let group = 0; group < groups; group++) {
    const texel = row < 3 ? 3 * group + row : 3 * groups + 6 * group + row - 3;
    for (let i = 0; i < GROUP; i++) {
      total += texels[4 * (start + texel) + i]! * weights[GROUP * group + i]!;
    }
  }
  return total;
}

function weightsOf(of: Surface, packed: PackedSurface, state: ArrayLike<number>): Float32Array {
  const weights = new Float32Array(GROUP * packed.groups);
  writeWeights(of, state, weights, 0, packed.groups);
  return weights;
}

function normalOf(packed: PackedSurface, weights: Float32Array, node: number): number[] {
  const tangent = (mean: Float32Array, first: number): number[] =>
    [0, 1, 2].map((axis) => mean[3 * node + axis]! + packed.tangentScale * sum(packed, weights, node, first + axis));
  return unit(cross(tangent(packed.across, 3), tangent(packed.along, 6)));
}

function cross(a: number[], b: number[]): number[] {
  return [a[1]! * b[2]! - a[2]! * b[1]!, a[2]! * b[0]! - a[0]! * b[2]!, a[0]! * b[1]! - a[1]! * b[0]!];
}

function unit(vector: number[]): number[] {
  const length = Math.hypot(...vector);
  return vector.map((value) => value / length);
}

describe.each(vectors.states.map((state, number) => ({ state, number })))("state $number", ({ state, number }) => {
  const packed = packedOf(surface);
  const weights = weightsOf(surface, packed, state);

  test("nodes are where Python puts them together", () => {
    const frame = surfaceFrame(surface, state);
    for (let node = 0; node < surface.nodes; node++) {
      const own = [0, 1, 2].map((axis) => surface.mean[3 * node + axis]! + sum(packed, weights, node, axis));
      inWorld(frame, own).forEach((value, axis) => expect(value).toBeCloseTo(vectors.nodes[number]![3 * node + axis]!, 4));
    }
  });

  test("normals are those of the faces around, within some degrees on so coarse a cloth", () => {
    const { turn } = surfaceFrame(surface, state);
    const angles = Array.from({ length: surface.nodes }, (_, node) => {
      const turned = inWorld({ origin: [0, 0, 0], turn }, normalOf(packed, weights, node));
      const cosine = turned.reduce((total, value, axis) => total + value * vectors.normals[number]![3 * node + axis]!, 0);
      return (Math.acos(Math.min(cosine, 1)) * 180) / Math.PI;
    });
    expect(Math.sqrt(angles.reduce((total, angle) => total + angle * angle, 0) / angles.length)).toBeLessThan(4);
    expect(Math.max(...angles)).toBeLessThan(15);
  });
});

test("normals of a surface that a linear map moves are exactly those of the map", () => {
  // Amplitudes of three shapes: a shear, a turn to the front, and a stretch.
  const shear = (x: number, y: number, z: number): number[] => [0.3 * z, 0.2 * x + 0.4 * z, 0.1 * y];
  const modes = new Int16Array(3 * surface.nodes);
  const scale = 1e-4;
  for (let node = 0; node < surface.nodes; node++) {
    const [x, y, z] = surface.mean.subarray(3 * node, 3 * node + 3);
    modes.set(shear(x!, y!, z!).map((value) => Math.round(value / scale)), 3 * node);
  }
  const sheared: Surface = { ...surface, modes, scales: Float32Array.of(scale), shapes: 1 };
  const packed = packedOf(sheared);
  const state = vectors.states[0]!.map((_, i) => (i === surface.first ? 1 : 0));
  const weights = weightsOf(sheared, packed, state);
  // The cloth lies across Y: its edges along X and Z go to these.
  const moved = (x: number, z: number): number[] => shear(x, 0, z).map((value, axis) => value + [x, 0, z][axis]!);
  const wanted = unit(cross(moved(1, 0), moved(0, 1)));
  const side = Math.sign(normalOf(packed, weights, 0).reduce((total, value, axis) => total + value * wanted[axis]!, 0));
  for (let node = 0; node < surface.nodes; node++) {
    normalOf(packed, weights, node).forEach((value, axis) => expect(value).toBeCloseTo(side * wanted[axis]!, 2));
  }
});

test("a surface too large for a texture keeps as many of its first shapes as find room", () => {
  expect(groupsWithRoom(5_000, 24)).toBe(24);
  const kept = groupsWithRoom(100_000, 64);
  const rows = (groups: number): number => Math.ceil(100_000 / Math.floor(4096 / (ROWS * groups)));
  expect(rows(kept)).toBeLessThanOrEqual(4096);
  expect(rows(kept + 1)).toBeGreaterThan(4096);
});

test("the gap between two states is that of their amplitudes and of where they are held", () => {
  const one = vectors.states[0]!;
  expect(surfaceGap(surface, one, one)).toBe(0);
  const moved = one.map((value, i) => (i === 1 ? value + 0.3 : i === surface.first ? value - 0.4 : value));
  expect(surfaceGap(surface, one, moved)).toBeCloseTo(0.5, 6);
});

test("what is held is what no shape moves: the upper edge", () => {
  expect(heldNodes(surface)).toEqual(Array.from({ length: 13 }, (_, node) => node));
});

test("a square of cloth is open, and what has no edge is closed", () => {
  expect(isClosed(surface)).toBe(false);
  expect(isClosed({ nodes: 4, faces: Uint32Array.of(0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3) })).toBe(true);
});

test("a cloth that hangs across Y shows its face along Y", () => {
  expect(Math.abs(Math.cos(facing(surface)))).toBeLessThan(1e-6);
});

test("modes that do not fit are refused by name", () => {
  const arrays = { ...(vectors.surface as unknown as SurfaceArrays), modes: "AAAAAA==" };
  expect(() => surfaceOf(arrays)).toThrow(/modes/);
});
