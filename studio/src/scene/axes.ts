// The border between physics (Z up) and three.js (Y up).

import { Object3D, Quaternion, Vector3 } from "three";

/** Return an object whose children are in physics' axes, Z up. */
export function physicsRoot(): Object3D {
  const root = new Object3D();
  root.name = "physics";
  root.rotation.x = -Math.PI / 2;
  root.updateMatrixWorld(true);
  return root;
}

/** Return a point of physics [m] in three.js' axes. */
export function toThree(point: ArrayLike<number>): Vector3 {
  return new Vector3(point[0], point[2], -point[1]!);
}

/** Return a point of three.js in physics' axes [m]. */
export function toPhysics(point: Vector3): [number, number, number] {
  return [point.x, -point.z, point.y];
}

/** Return a quaternion wxyz as three.js' own. */
export function toQuaternion(wxyz: ArrayLike<number>): Quaternion {
  return new Quaternion(wxyz[1], wxyz[2], wxyz[3], wxyz[0]);
}
