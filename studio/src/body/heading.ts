// Headings, seen from above.

/** Degrees per radian, for angles shown to people. */
export const DEGREES = 180 / Math.PI;

/** Return the heading [rad] of a quaternion (w, x, y, z): the angle from the world's X to its own, about Z. */
export function quaternionHeading(quaternion: readonly number[]): number {
  const [w, x, y, z] = quaternion as readonly [number, number, number, number];
  return Math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z));
}
