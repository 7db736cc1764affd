// Where something points, seen from above.

/** What people read of an angle [degrees per radian]. */
export const DEGREES = 180 / Math.PI;

/** Return the heading [rad] of a quaternion (w, x, y, z): the angle from X to where its X points, about Z. */
export function quaternionHeading(quaternion: readonly number[]): number {
  const [w, x, y, z] = quaternion as readonly [number, number, number, number];
  return Math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z));
}
