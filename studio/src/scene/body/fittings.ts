// The fittings of a cloth: a rod along the held nodes, if they lie in a row, or a button at each of them.

import { BufferGeometry, CylinderGeometry, Quaternion, SphereGeometry, Vector3 } from "three";
import { mergeGeometries } from "three/addons/utils/BufferGeometryUtils.js";
import { heldNodes, type Surface } from "../../body/surface";

/** Radius of a rod, its reach beyond the nodes it holds, and radius of a button, over the body's size. */
const ROD = 0.009;
const BEYOND = 0.03;
const BUTTON = 0.011;

/** Maximum distance of nodes from a row, over its length, and from each other. */
const STRAIGHT = 0.02;
const CLOSE = 0.15;

/** Maximum number of buttons: a cloth sewn to something has none. */
const MAX_BUTTONS = 64;

/** Return the shape in the surface's own frame, for a body of `size` [m]; null if its fittings are invisible. */
export function fittingsGeometry(surface: Surface, size: number): BufferGeometry | null {
  const places = heldNodes(surface).map((node) => new Vector3().fromArray(surface.mean, 3 * node));
  const row = inRow(places);
  if (row) {
    return rod(row[0]!, row[row.length - 1]!, size);
  }
  if (places.length === 0 || places.length > MAX_BUTTONS) {
    return null;
  }
  return mergeGeometries(places.map(({ x, y, z }) => new SphereGeometry(BUTTON * size, 12, 8).translate(x, y, z)));
}

/** Return places in their order along a straight row; null if they are not in a row. */
function inRow(places: readonly Vector3[]): Vector3[] | null {
  const start = places[0];
  if (!start) {
    return null;
  }
  const first = farthestFrom(start, places);
  const last = farthestFrom(first, places);
  const along = last.clone().sub(first);
  const length = along.length();
  const sorted = [...places].sort((a, b) => a.distanceToSquared(first) - b.distanceToSquared(first));
  const isStraight = places.every((place) => place.clone().sub(first).cross(along).length() < STRAIGHT * length * length);
  const isClose = sorted.every((place, i) => i === 0 || place.distanceTo(sorted[i - 1]!) < CLOSE * length);
  return length > 0 && isStraight && isClose ? sorted : null;
}

function farthestFrom(from: Vector3, places: readonly Vector3[]): Vector3 {
  return places.reduce((farthest, place) => (place.distanceTo(from) > farthest.distanceTo(from) ? place : farthest));
}

function rod(first: Vector3, last: Vector3, size: number): BufferGeometry {
  const along = last.clone().sub(first);
  const length = along.length() + 2 * BEYOND * size;
  const middle = first.clone().add(last).divideScalar(2);
  const geometry = new CylinderGeometry(ROD * size, ROD * size, length, 20);
  const turn = new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), along.normalize());
  return geometry.applyQuaternion(turn).translate(middle.x, middle.y, middle.z);
}
