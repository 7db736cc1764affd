// Many copies of a few things on endless ground: those left behind reappear in front.

import { InstancedMesh, Matrix4, Quaternion, Vector3, type BufferGeometry, type Material } from "three";
import type { Random } from "./random";

/** One copy: its position in the repeating tile (x and z, 0 to 1), and its pose. */
export interface Copy {
  readonly x: number;
  readonly z: number;
  readonly lift: number;
  readonly turn: Quaternion;
  readonly scale: Vector3;
}

export interface Scatter {
  readonly mesh: InstancedMesh;
  /** Put every copy at its position nearest to `focus`, on ground of this height. */
  update(focus: Vector3, ground: (x: number, z: number) => number): void;
  dispose(): void;
}

/** Scatter `copies` of an object over a tile of side `tile` [m]. */
export function makeScatter(
  geometry: BufferGeometry,
  material: Material,
  copies: readonly Copy[],
  tile: number,
): Scatter {
  const mesh = new InstancedMesh(geometry, material, copies.length);
  mesh.frustumCulled = false;
  const matrix = new Matrix4();
  const place = new Vector3();
  const last = new Vector3(Infinity, 0, 0);
  let lastGround = NaN;
  return {
    mesh,
    update(focus, ground) {
      const height = ground(0, 0);
      const hasMoved = Math.hypot(focus.x - last.x, focus.z - last.z) > tile / 40;
      if (!hasMoved && height === lastGround) {
        return;
      }
      last.copy(focus);
      lastGround = height;
      copies.forEach((copy, i) => {
        place.x = nearest(copy.x * tile, focus.x, tile);
        place.z = nearest(copy.z * tile, focus.z, tile);
        place.y = ground(place.x, place.z) + copy.lift;
        mesh.setMatrixAt(i, matrix.compose(place, copy.turn, copy.scale));
      });
      mesh.instanceMatrix.needsUpdate = true;
    },
    dispose() {
      geometry.dispose();
      material.dispose();
      mesh.dispose();
    },
  };
}

/** Return the number nearest to `focus` that differs from `base` by whole tiles. */
function nearest(base: number, focus: number, tile: number): number {
  return base + tile * Math.round((focus - base) / tile);
}

/** Return places for copies, in clumps, which look more natural. */
export function clumpedPlaces(random: Random, count: number, clumps: number, spread: number): [number, number][] {
  const centres = Array.from({ length: clumps }, () => [random(), random()] as const);
  return Array.from({ length: count }, (_, i) => {
    const [x, z] = centres[i % clumps]!;
    const distance = spread * Math.sqrt(-Math.log(1 - 0.95 * random()));
    const angle = 2 * Math.PI * random();
    return [fraction(x + distance * Math.cos(angle)), fraction(z + distance * Math.sin(angle))];
  });
}

function fraction(value: number): number {
  return value - Math.floor(value);
}
