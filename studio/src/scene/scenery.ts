// The interface of scenes: light, ground and air around a body.

import type { Quaternion, Vector3 } from "three";
import type { Patch } from "./glsl";
import type { Atmosphere } from "./stage";

/** The facts of an image for the scenery. */
export interface Moment {
  /** Time that goes on while the motion is paused [s], but not with reduced motion. */
  readonly time: number;
  readonly seconds: number;
  /** The look-at point, in three.js' axes. */
  readonly focus: Vector3;
  /** Rotation of the body, in three.js' axes. */
  readonly turn: Quaternion;
  /** Lowest and highest point of the body [m]. */
  readonly low: number;
  readonly high: number;
  /** The current control (C), each number as a share of its bounds, 0 to 1. */
  readonly controls: readonly number[];
}

export interface Scenery {
  readonly atmosphere: Atmosphere;
  /** Patches for the materials of bodies in this scenery. */
  readonly bodyPatches: readonly Patch[];
  /** Height of the water's surface [m], if there is one. */
  readonly surface?: number;
  /** Height of the surface in the physics [m], out of which a body may leap. */
  readonly waterline?: number;
  /** Height of the ground, the minimum for the camera [m]. */
  readonly ground: number;
  /** Make things visible up to a distance [m]; not every place needs it. */
  see?(distance: number): void;
  update(moment: Moment): void;
  dispose(): void;
}

/** Size and initial position of the body, to which scenery is fitted. */
export interface Measure {
  /** Its longest side [m]. */
  readonly size: number;
  /** Its initial middle, in three.js' axes. */
  readonly middle: Vector3;
  readonly low: number;
  readonly high: number;
}
