// Stones: smooth, unevenly worn balls.

import { IcosahedronGeometry, Vector3, type BufferGeometry } from "three";
import { mergeVertices } from "three/addons/utils/BufferGeometryUtils.js";

/** Return a flattened stone of about radius 1, which depends on `seed`. */
export function stoneGeometry(seed: number): BufferGeometry {
  const ball = new IcosahedronGeometry(1, 3).deleteAttribute("uv").deleteAttribute("normal");
  const geometry = mergeVertices(ball);
  const positions = geometry.getAttribute("position");
  const point = new Vector3();
  for (let i = 0; i < positions.count; i++) {
    point.fromBufferAttribute(positions, i);
    const { x, y, z } = point;
    const bumps =
      0.2 * Math.sin(2.3 * x + seed) * Math.cos(1.9 * y + 2 * seed) +
      0.14 * Math.sin(3.1 * z + 1.3 * seed + x) +
      0.05 * Math.sin(7 * x + 5 * y + seed) * Math.sin(6 * z - seed);
    point.multiplyScalar(1 + bumps);
    positions.setXYZ(i, point.x, 0.62 * point.y, point.z);
  }
  geometry.computeVertexNormals();
  return geometry;
}
