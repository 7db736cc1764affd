// Quaternions wxyz, as everywhere inside NeuroAnimator.

/** Return the product: `b` acts first, then `a`. */
export function multiply(a: ArrayLike<number>, b: ArrayLike<number>): number[] {
  const aw = a[0]!, ax = a[1]!, ay = a[2]!, az = a[3]!;
  const bw = b[0]!, bx = b[1]!, by = b[2]!, bz = b[3]!;
  return [
    aw * bw - ax * bx - ay * by - az * bz,
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
  ];
}

/** Return `vector` rotated by a unit quaternion. */
export function rotate(quaternion: ArrayLike<number>, vector: ArrayLike<number>): number[] {
  const w = quaternion[0]!, x = quaternion[1]!, y = quaternion[2]!, z = quaternion[3]!;
  const vx = vector[0]!, vy = vector[1]!, vz = vector[2]!;
  // v + 2 w (q × v) + 2 q × (q × v)
  const cx = 2 * (y * vz - z * vy);
  const cy = 2 * (z * vx - x * vz);
  const cz = 2 * (x * vy - y * vx);
  return [
    vx + w * cx + y * cz - z * cy,
    vy + w * cy + z * cx - x * cz,
    vz + w * cz + x * cy - y * cx,
  ];
}

/** Return the normalised quaternion; no rotation for a zero one. */
export function normalised(quaternion: ArrayLike<number>): number[] {
  const numbers = [quaternion[0]!, quaternion[1]!, quaternion[2]!, quaternion[3]!];
  const length = Math.hypot(...numbers);
  return length > 0 ? numbers.map((component) => component / length) : [1, 0, 0, 0];
}

/** Return the quaternion of a right-handed frame, given by the world's components of its axes. */
export function quaternionOfAxes(x: ArrayLike<number>, y: ArrayLike<number>, z: ArrayLike<number>): number[] {
  const m00 = x[0]!, m10 = x[1]!, m20 = x[2]!;
  const m01 = y[0]!, m11 = y[1]!, m21 = y[2]!;
  const m02 = z[0]!, m12 = z[1]!, m22 = z[2]!;
  // The largest of the four components comes first, to avoid a division by a small number.
  const traces = [m00 + m11 + m22, m00 - m11 - m22, m11 - m00 - m22, m22 - m00 - m11];
  const largest = traces.indexOf(Math.max(...traces));
  const twice = Math.sqrt(1 + traces[largest]!) * 2;
  const products = [
    [twice / 4, (m21 - m12) / twice, (m02 - m20) / twice, (m10 - m01) / twice],
    [(m21 - m12) / twice, twice / 4, (m10 + m01) / twice, (m02 + m20) / twice],
    [(m02 - m20) / twice, (m10 + m01) / twice, twice / 4, (m21 + m12) / twice],
    [(m10 - m01) / twice, (m02 + m20) / twice, (m21 + m12) / twice, twice / 4],
  ];
  return products[largest]!;
}
