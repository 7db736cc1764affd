// What every scene can do: light, ground and air around a body.

import type { Quaternion, Vector3 } from "three";
import type { Patch } from "./glsl";
import type { Atmosphere } from "./stage";

/** What the scenery may know of an image. */
export interface Moment {
  /** Time that goes on even if the motion stands still [s]; it stands still where motion is to be reduced. */
  readonly time: number;
  readonly seconds: number;
  /** What is looked at, in three.js' axes. */
  readonly focus: Vector3;
  /** How the body is turned, in three.js' axes. */
  readonly turn: Quaternion;
  /** Lowest and highest point of the body [m]. */
  readonly low: number;
  readonly high: number;
  /** The control (C) held at present, each number as a share of its bounds, 0 to 1. */
  readonly controls: readonly number[];
}

export interface Scenery {
  readonly atmosphere: Atmosphere;
  /** What the materials of bodies need so that they belong here. */
  readonly bodyPatches: readonly Patch[];
  /** Height of the water's surface [m], if there is one. */
  readonly surface?: number;
  /** Height of the surface that physics knows [m]: a body may leap out of it. */
  readonly waterline?: number;
  /** The ground's height below which the camera does not go [m]. */
  readonly ground: number;
  update(moment: Moment): void;
  dispose(): void;
}

/** How large the body is and where it begins: scenery is made to its measure. */
export interface Measure {
  /** Its longest side [m]. */
  readonly size: number;
  /** Its middle at first, in three.js' axes. */
  readonly middle: Vector3;
  readonly low: number;
  readonly high: number;
}
