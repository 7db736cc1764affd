// The camera: it follows the body, or stays, and is turned by mouse, finger and keyboard.

import { MathUtils, Vector3, type PerspectiveCamera } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

export const CAMERA_MODES = ["follow", "chase", "orbit"] as const;
export type CameraMode = (typeof CAMERA_MODES)[number];

/** Time constant with which the camera follows the body [s]. */
const LAG = 0.35;

/** Time constant with which the camera turns with the body [s], slow enough to ignore single strokes and strides. */
const TURN_LAG = 0.5;

/** Ratio of width to height below which the body is shown from further away. */
const NARROW = 1.2;

/** Maximum distance of the look-at point from the body, over its size. */
const MAX_LAG = 0.4;

/** Time constant with which the camera rises out of the water, and goes back [s]. */
const RISE = 0.16;

/** Minimum distance up to which things are drawn [m]: that of hills and trees. */
const FARTHEST = 1000;

/** Turn per key press [rad], and zoom factor. */
const KEY_TURN = 0.12;
const KEY_ZOOM = 1.12;

export class CameraRig {
  readonly controls: OrbitControls;
  mode: CameraMode = "follow";
  /** Minimum height of the camera [m]. */
  ground = -Infinity;
  /** Height to which the camera rises [m], unless null. */
  lookFrom: number | null = null;
  #lift = 0;
  #clearance = 0;
  #maxLag = Infinity;
  /** Left turn of the body that the camera has not followed yet [rad]. */
  #owedTurn = 0;

  constructor(
    private readonly camera: PerspectiveCamera,
    element: HTMLElement,
  ) {
    this.controls = new OrbitControls(camera, element);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = 0.12;
    this.controls.maxPolarAngle = Math.PI * 0.96;
  }

  /** Look at `focus` from `azimuth` and `elevation` [rad], with a body of `size` [m] filling a good share of the picture. */
  frame(focus: Vector3, size: number, heading: number, azimuth: number, elevation: number, distance: number): void {
    const far = distance * size * Math.max(1, NARROW / this.camera.aspect);
    const angle = heading + azimuth;
    const offset = new Vector3(
      Math.cos(elevation) * Math.cos(angle),
      Math.sin(elevation),
      -Math.cos(elevation) * Math.sin(angle),
    );
    this.controls.target.copy(focus);
    this.camera.position.copy(focus).addScaledVector(offset, far);
    this.camera.near = 0.02 * size;
    this.camera.far = Math.max(200 * size, FARTHEST);
    this.camera.updateProjectionMatrix();
    this.controls.minDistance = 0.5 * size;
    this.controls.maxDistance = Math.max(12 * size, 2 * far);
    this.#clearance = 0.12 * size;
    this.#maxLag = MAX_LAG * size;
    this.controls.update();
  }

  /** Follow `focus`, at once with reduced motion. `turned` is the body's left turn [rad]. */
  update(focus: Vector3, turned: number, seconds: number): void {
    this.camera.position.y -= this.#lift;
    if (this.mode !== "orbit") {
      const share = 1 - Math.exp(-seconds / LAG);
      const behind = focus.clone().sub(this.controls.target);
      const shift = behind.clone().multiplyScalar(share);
      const rest = behind.length() * (1 - share);
      if (rest > this.#maxLag) {
        shift.addScaledVector(behind.normalize(), rest - this.#maxLag);
      }
      this.controls.target.add(shift);
      this.camera.position.add(shift);
      if (this.mode === "chase") {
        this.#chase(turned, seconds);
      }
    }
    this.controls.update();
    this.#rise(seconds);
    const lowest = this.ground + this.#clearance;
    if (this.camera.position.y < lowest) {
      this.camera.position.y = lowest;
      this.camera.lookAt(this.controls.target);
    }
  }

  #chase(turned: number, seconds: number): void {
    this.#owedTurn += turned;
    const turn = this.#owedTurn * (1 - Math.exp(-seconds / TURN_LAG));
    this.#owedTurn -= turn;
    this.turn(turn, 0);
  }

  // A leap is always seen from above the water.
  #rise(seconds: number): void {
    const missing = this.lookFrom === null ? 0 : Math.max(this.lookFrom - this.camera.position.y, 0);
    const wanted = this.mode === "orbit" ? 0 : missing;
    this.#lift += (wanted - this.#lift) * (1 - Math.exp(-seconds / RISE));
    if (this.#lift > 1e-4) {
      this.camera.position.y += this.#lift;
      this.camera.lookAt(this.controls.target);
    }
  }

  /** Orbit the look-at point by angles [rad]. */
  turn(left: number, up: number): void {
    const offset = this.camera.position.clone().sub(this.controls.target);
    offset.applyAxisAngle(new Vector3(0, 1, 0), left);
    const side = new Vector3(0, 1, 0).cross(offset).normalize();
    const elevation = Math.asin(MathUtils.clamp(offset.y / offset.length(), -1, 1));
    const bounded = MathUtils.clamp(elevation + up, -1.45, 1.5) - elevation;
    offset.applyAxisAngle(side, -bounded);
    this.camera.position.copy(this.controls.target).add(offset);
  }

  /** Turn by a key: -1, 0 or 1 to the left and up. */
  keyTurn(left: number, up: number): void {
    this.turn(KEY_TURN * left, KEY_TURN * up);
  }

  /** Zoom in or out by a key. */
  keyZoom(isNearer: boolean): void {
    const offset = this.camera.position.clone().sub(this.controls.target);
    offset.multiplyScalar(isNearer ? 1 / KEY_ZOOM : KEY_ZOOM);
    offset.clampLength(this.controls.minDistance, this.controls.maxDistance);
    this.camera.position.copy(this.controls.target).add(offset);
  }

  nextMode(): CameraMode {
    this.#owedTurn = 0;
    const next = (CAMERA_MODES.indexOf(this.mode) + 1) % CAMERA_MODES.length;
    this.mode = CAMERA_MODES[next]!;
    return this.mode;
  }

  dispose(): void {
    this.controls.dispose();
  }
}
