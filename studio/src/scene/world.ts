// All that is seen of one system: scenery, the body, its ghost, and the camera in front of them.

import { Plane, Quaternion, Raycaster, Vector2, Vector3, type Object3D } from "three";
import { collidersOf, endsOf, type Collider } from "../body/colliders";
import { extentOf, movingBones, reachOf, sizeOfBody } from "../body/extent";
import { emptyPose, poseBones, type Pose } from "../body/pose";
import { cornersOf, facing, inWorld, surfaceFrame, surfaceOf, type Box, type Frame, type Surface } from "../body/surface";
import { isSkinnedPoints, isTumbling, isWalking, type Bundle } from "../bundle/bundle";
import { toPhysics, toQuaternion, toThree } from "./axes";
import { makeBody, makeGhost, type BodyView } from "./body/body";
import { makeMount } from "./body/mount";
import { CameraRig } from "./cameras";
import { makeLot } from "./lot";
import { makeMoon } from "./moon";
import { makePlain } from "./plain";
import { makeCrowdView, type CrowdView } from "./crowd";
import { makeWalkersView, type WalkersView } from "./walkers";
import { makeFoodView, type FoodView } from "./food";
import { makeSchoolView, type SchoolView } from "./school";
import type { ShadowGround } from "./school_shadows";
import type { Crowd } from "../steering/crowd";
import { SMALL, type Life } from "../steering/life";
import type { Room, School } from "../steering/school";
import { RADIUS as WALKERS_RADIUS, type Walkers } from "../steering/walkers";
import type { Measure, Scenery } from "./scenery";
import type { Atmosphere, PictureSize, Stage } from "./stage";
import { makeWater } from "./water/water";

/** Half the width of where shadows fall, over the body's size. */
const SHADOW_REACH = 2.6;

/** Where the camera begins: to the side of the body, from a little above or, under water, below [rad]. */
interface View {
  readonly azimuth: number;
  readonly elevation: number;
  /** Over the body's size. */
  readonly distance: number;
}

const VIEWS: Record<Bundle["scene"]["kind"], View> = {
  water: { azimuth: -1.05, elevation: 0.12, distance: 2.5 },
  lot: { azimuth: 0.85, elevation: 0.3, distance: 2.5 },
  moon: { azimuth: 0.7, elevation: 0.16, distance: 3.4 },
  plain: { azimuth: -1.35, elevation: 0.1, distance: 2.2 },
};

/** What hangs is seen all around where it hangs: it may swing up. */
const HUNG_VIEW: View = { ...VIEWS.plain, distance: 3 };

/** A thrown body is seen from further away, and the camera stays at this height over the ground while it bounces; over its size. */
const THROWN_VIEW: View = { azimuth: -1.1, elevation: 0.2, distance: 5.2 };
const THROWN_HEIGHT = 1.1;

/** A cloth is seen from the side of its face [rad], and from a little above. */
const CLOTH_VIEW: View = { azimuth: -0.7, elevation: 0.18, distance: 2.4 };

/** The sun stands to the other side of a cloth's face, so that folds are seen: where [rad]. */
const CLOTH_SUN = { azimuth: 0.75, elevation: 0.75 };

/** Where nothing is said of a ground, it lies so far under a cloth, over its size: what strikes it may come lower. */
const UNDER_CLOTH = 0.25;

/** A shark among small fish is seen from this far, over its size. */
const LIFE_DISTANCE = 4.5;

/** A walker is seen from behind and a little aside; with others around it from further away, and from higher up. */
const WALKER_VIEW: View = { azimuth: 2.7, elevation: 0.16, distance: 2.3 };
const AMONG_WALKERS: View = { azimuth: 2.7, elevation: 0.42, distance: 6 };

/** A crowd is seen from this far, over how far its outermost stand, and from higher up [rad]. */
const CROWD_DISTANCE = 1.8;
const CROWD_ELEVATION = 0.42;

/** A state is never drawn if one of its numbers is larger [m, rad, …]: it is lost. */
const MAX_NUMBER = 1e5;

/** A body that reaches so far out of the water leaps, and is then looked at from so high over it; over its size. */
const EMERGED = 0.1;
const OVER_WATER = 0.3;

/** How near to a bone a swimmer is taken hold of, over its size. */
const GRIP = 0.12;

/** However small a mover is, it is taken hold of so near to it, over the body's size: a finger is no needle. */
const MOVER_GRIP = 0.06;

/** A point of a body that is held: [m], in the world. */
export interface Grip {
  readonly bone: number;
  readonly point: [number, number, number];
}

export class World {
  readonly size: number;
  readonly camera: CameraRig;
  readonly pose: Pose;
  /** Whether the camera stays where it is: who drags what it goes after would otherwise never catch up. */
  isCameraHeld = false;
  /** The bones that move. */
  readonly bones: number[];
  readonly #body: BodyView;
  readonly #ghost: BodyView;
  readonly ghostPose: Pose;
  readonly #scenery: Scenery;
  readonly #atmosphere: Atmosphere;
  /** Where a surface shows its face [rad]. */
  readonly #face: number;
  readonly #focus = new Vector3();
  /** What the camera looks at: the body, or for one that bounces where it is along the ground. */
  readonly #lookAt = new Vector3();
  readonly #isTumbling: boolean;
  readonly #surface: Surface | null;
  readonly #colliders: readonly Collider[];
  /** Where the surface's own frame is. */
  #frame: Frame = { origin: [0, 0, 0], turn: [1, 0, 0, 0] };
  readonly #objects: Object3D[];
  #fixedFocus: Vector3 | null = null;
  #school: SchoolView | null = null;
  #food: FoodView | null = null;
  #crowd: CrowdView | null = null;
  #walkers: WalkersView | null = null;
  readonly #groundHeight = { value: 0 };
  #low = 0;
  #high = 0;
  #heading = 0;
  #isFresh = true;

  constructor(
    private readonly stage: Stage,
    readonly facts: Bundle,
    start: ArrayLike<number>,
    isDark: boolean,
  ) {
    const bones = facts.skeleton;
    this.#isTumbling = isTumbling(facts);
    this.#surface = facts.surface ? surfaceOf(facts.surface) : null;
    this.#colliders = collidersOf(bones);
    this.bones = movingBones(bones);
    this.pose = emptyPose(bones.length);
    this.ghostPose = emptyPose(bones.length);
    poseBones(bones, facts.rest, this.pose);
    this.size = this.#surface ? longestSide(this.#surface.box) : sizeOfBody(bones, this.bones, this.pose);
    const lowAtRest = extentOf(bones, this.bones, this.pose).low;
    this.#pose(start);
    this.#locate();
    const measure: Measure = {
      size: this.size,
      middle: this.#focus.clone(),
      // What hangs may begin higher than it will ever be again.
      low: facts.scene.kind === "plain" ? Math.min(this.#low, lowAtRest) - this.#depthBelow : this.#low,
      high: this.#high,
    };
    this.#scenery = makeScenery(stage, facts, measure, isDark);
    const mount = makeMount(facts, this.#scenery.ground, this.size);
    this.#body = makeBody(facts, this.size, this.#focus, this.#scenery.bodyPatches);
    this.#ghost = makeGhost(facts, this.size);
    this.#ghost.object.visible = false;
    this.#objects = [this.#body.object, this.#ghost.object];
    if (mount) {
      this.#objects.push(mount.object);
      // What hangs in one place is looked at there: a camera that went along would swing.
      this.#fixedFocus = toThree(mount.pivot);
      this.#locate();
    }
    for (const still of [this.#body.scenery, this.#body.goalPaint]) {
      if (still) {
        this.#objects.push(still);
      }
    }
    stage.root.add(...this.#objects);
    this.#face = this.#surface ? this.#faceOf(this.#surface) : 0;
    this.#atmosphere = this.#surface ? { ...this.#scenery.atmosphere, sunDirection: sunFor(this.#face) } : this.#scenery.atmosphere;
    stage.light(this.#atmosphere, SHADOW_REACH * this.size);
    this.camera = new CameraRig(stage.camera, stage.canvas);
    if (isWalking(facts)) {
      this.camera.mode = "chase";
    }
    this.home();
  }

  /** Bring the camera back to where it began. */
  home(): void {
    const view = this.#view();
    this.#aim();
    this.camera.frame(this.#lookAt, this.size, this.#heading, view.azimuth, view.elevation, view.distance);
  }

  /** How far under the body at rest a ground lies that nothing says where it is [m], beside what it keeps of any body. */
  get #depthBelow(): number {
    return this.#surface ? UNDER_CLOTH * this.size : 0;
  }

  #view(): View {
    if (this.#surface) {
      const azimuth = this.#face + CLOTH_VIEW.azimuth;
      if (this.#crowd) {
        return { azimuth, elevation: CROWD_ELEVATION, distance: (CROWD_DISTANCE * this.#crowd.radius) / this.size };
      }
      return { ...CLOTH_VIEW, azimuth };
    }
    if (this.#isTumbling) {
      return THROWN_VIEW;
    }
    if (isWalking(this.facts)) {
      return this.#walkers ? AMONG_WALKERS : WALKER_VIEW;
    }
    const view = this.#fixedFocus ? HUNG_VIEW : VIEWS[this.facts.scene.kind];
    return this.#food ? { ...view, distance: LIFE_DISTANCE } : view;
  }

  /** Show the body in `state` (S); a state that is lost is not shown, and false is returned: the last good pose stays. */
  show(state: ArrayLike<number>): boolean {
    if (!isDrawable(state)) {
      return false;
    }
    this.#pose(state);
    this.#body.update(this.pose, state);
    return true;
  }

  /** Show physics beside the emulator in `state` (S), or nothing. */
  showGhost(state: ArrayLike<number> | null): void {
    const isShown = state !== null && isDrawable(state);
    this.#ghost.object.visible = isShown;
    if (isShown) {
      poseBones(this.facts.skeleton, state, this.ghostPose);
      this.#ghost.update(this.ghostPose, state);
    }
  }

  /** How much the body is in doubt, 0 to 1. */
  set doubt(share: number) {
    this.#body.doubt.value = share;
  }

  /** The middle of the body [m]. */
  get middle(): [number, number, number] {
    return toPhysics(this.#focus);
  }

  /** Heights between which there is room to swim [m]. */
  get room(): Room {
    return { low: this.#scenery.ground, high: this.#scenery.surface ?? Infinity };
  }

  /** Draw a school around the body, or none, at `scale`. */
  showSchool(school: School | null, scale = 1): void {
    for (const view of [this.#school, this.#food]) {
      if (view) {
        this.stage.root.remove(view.object);
        view.dispose();
      }
    }
    this.#food = null;
    this.#paintAsShark(0);
    this.#school = school && makeSchoolView(this.facts, school, this.#shadowGround(), this.#scenery.bodyPatches, scale);
    if (this.#school) {
      this.stage.root.add(this.#school.object);
    }
  }

  /** Draw small fish and their food around the body, and look at them from further away. */
  showLife(life: Life): void {
    this.showSchool(life.school, SMALL);
    this.#paintAsShark(1);
    this.#food = makeFoodView(life, this.size);
    this.stage.root.add(this.#food.object);
    this.home();
  }

  #paintAsShark(share: number): void {
    if (this.#body.shark) {
      this.#body.shark.value = share;
    }
  }

  /** Draw a crowd around the body, or none, and look at all of it. */
  showCrowd(crowd: Crowd | null): void {
    if (this.#crowd) {
      this.stage.root.remove(this.#crowd.object);
      this.#crowd.dispose();
    }
    this.#crowd = crowd && makeCrowdView(this.facts, crowd, this.size, this.#scenery.bodyPatches);
    if (this.#crowd) {
      crowd!.show((number, state) => this.showInCrowd(number, state));
      this.stage.root.add(this.#crowd.object);
    }
    this.stage.light(this.#atmosphere, SHADOW_REACH * this.size + (this.#crowd?.radius ?? 0));
    this.home();
  }

  /** Draw others who walk around the body, or none, and look at all of them. */
  showWalkers(walkers: Walkers | null): void {
    if (this.#walkers) {
      this.stage.root.remove(this.#walkers.object);
      this.#walkers.dispose();
    }
    this.#walkers = walkers && makeWalkersView(this.facts, walkers.count, this.#scenery.bodyPatches);
    if (this.#walkers) {
      walkers!.show((number, state) => this.showWalker(number, state));
      this.stage.root.add(this.#walkers.object);
    }
    this.stage.light(this.#atmosphere, SHADOW_REACH * this.size + (this.#walkers ? WALKERS_RADIUS : 0));
    this.home();
  }

  /** Show one of those who walk around in `state` (S). */
  showWalker(number: number, state: Float32Array): void {
    this.#walkers?.show(number, state);
  }

  /** Show one of the crowd in `state` (S). */
  showInCrowd(number: number, state: Float32Array): void {
    this.#crowd?.show(number, state);
  }

  /** Draw an image. `controls` are shares of their bounds, 0 to 1; scenery stands still where motion is to be reduced. */
  draw(seconds: number, time: number, controls: readonly number[]): void {
    this.moveCamera(seconds);
    this.#groundHeight.value = this.#scenery.ground;
    this.#school?.update();
    this.#food?.update();
    this.stage.follow(this.#focus);
    this.#scenery.update({
      time,
      seconds,
      focus: this.#focus,
      turn: this.#turn(),
      low: this.#low,
      high: this.#high,
      controls,
    });
    this.stage.draw(seconds);
  }

  /** Let the camera go after the body for `seconds`; after infinitely many it has caught up. */
  moveCamera(seconds: number): void {
    const heading = this.#heading;
    this.#locate();
    let turned = this.#heading - heading;
    turned -= 2 * Math.PI * Math.round(turned / (2 * Math.PI));
    if (this.#isFresh) {
      this.#isFresh = false;
      turned = 0;
    }
    this.camera.ground = this.#scenery.ground;
    this.camera.lookFrom = this.#heightForLeap();
    this.#aim();
    this.camera.update(this.isCameraHeld ? this.camera.controls.target.clone() : this.#lookAt, turned, seconds);
  }

  get canvas(): HTMLCanvasElement {
    return this.stage.canvas;
  }

  /** See `Stage.filmSize`. */
  set filmSize(size: PictureSize | null) {
    this.stage.filmSize = size;
  }

  /** The point of the body under the pointer (-1 to 1 across the picture, and up), or null. */
  pick(x: number, y: number): Grip | null {
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(x, y), this.stage.camera);
    let nearest: Grip | null = null;
    let least = Infinity;
    for (const bone of this.bones) {
      const centre = toThree(this.pose.positions.subarray(3 * bone, 3 * bone + 3));
      const radius = isSkinnedPoints(this.facts) ? GRIP * this.size : 0.8 * reachOf(this.facts.skeleton[bone]!);
      const point = ray.ray.closestPointToPoint(centre, new Vector3());
      const away = point.distanceTo(centre);
      if (away < radius && away / radius < least) {
        least = away / radius;
        nearest = { bone, point: toPhysics(point) };
      }
    }
    return nearest;
  }

  /** The mover under the pointer, by the number of its bone among `bones`; null if there is none. The foremost is taken. */
  pickMover(x: number, y: number, bones: readonly number[]): Grip | null {
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(x, y), this.stage.camera);
    let nearest: Grip | null = null;
    let least = Infinity;
    for (const bone of bones) {
      const point = this.#pointOfMover(ray, bone);
      const distance = point?.distanceTo(ray.ray.origin) ?? Infinity;
      if (point && distance < least) {
        least = distance;
        nearest = { bone, point: toPhysics(point) };
      }
    }
    return nearest;
  }

  // Where a ray hits what is drawn of a bone, or else comes nearest to its spheres and capsules, or to the bone if it has none;
  // null if that is beside them.
  #pointOfMover(ray: Raycaster, bone: number): Vector3 | null {
    const drawn = this.#body.object.getObjectByName(this.facts.skeleton[bone]!.name);
    const [hit] = drawn ? ray.intersectObject(drawn) : [];
    if (hit) {
      return hit.point;
    }
    const colliders = this.#colliders.filter((collider) => collider.bone === bone);
    const itself: Collider = { bone, ends: [[0, 0, 0], [0, 0, 0]], radius: 0 };
    for (const collider of colliders.length > 0 ? colliders : [itself]) {
      const [start, end] = endsOf(collider, this.pose);
      const point = new Vector3();
      const square = ray.ray.distanceSqToSegment(toThree(start), toThree(end), point);
      if (Math.sqrt(square) < Math.max(collider.radius, MOVER_GRIP * this.size)) {
        return point;
      }
    }
    return null;
  }

  /** Unit vectors of the camera along the ground [m]: away from it, and to its left; in physics' axes. */
  get bearings(): { readonly ahead: [number, number, number]; readonly left: [number, number, number] } {
    const [x, y] = this.lookingAlong;
    const length = Math.hypot(x, y) || 1;
    return { ahead: [x / length, y / length, 0], left: [-y / length, x / length, 0] };
  }

  /** Unit vector in which the camera looks, in physics' axes. */
  get lookingAlong(): [number, number, number] {
    return toPhysics(this.stage.camera.getWorldDirection(new Vector3()));
  }

  /** Where the pointer is on the plane through `point` [m] that faces the camera, or lies level. */
  dragPoint(x: number, y: number, point: ArrayLike<number>, isLevel: boolean): [number, number, number] | null {
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(x, y), this.stage.camera);
    const normal = isLevel ? new Vector3(0, 1, 0) : this.stage.camera.getWorldDirection(new Vector3());
    const plane = new Plane().setFromNormalAndCoplanarPoint(normal, toThree(point));
    const hit = ray.ray.intersectPlane(plane, new Vector3());
    return hit && toPhysics(hit);
  }

  /** Where bone `number` is at present [m]. */
  bonePoint(number: number): [number, number, number] {
    const [x, y, z] = this.pose.positions.subarray(3 * number, 3 * number + 3);
    return [x!, y!, z!];
  }

  /** Return whether the pointer is near a place [m]. */
  isNear(x: number, y: number, place: ArrayLike<number>): boolean {
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(x, y), this.stage.camera);
    return ray.ray.distanceToPoint(toThree(place)) < 0.14 * this.size;
  }

  /** A place in front of the body and to its left [m], in lengths of the body. */
  ahead(forward: number, left: number): [number, number, number] {
    const [x, y, z] = toPhysics(this.#focus);
    const [cosine, sine] = [Math.cos(this.#heading), Math.sin(this.#heading)];
    const { size } = this;
    return [x + size * (forward * cosine - left * sine), y + size * (forward * sine + left * cosine), z];
  }

  /** Move what is painted where the goal is by so much from where it was at first [m]. */
  moveGoalPaint(by: ArrayLike<number>): void {
    this.#body.goalPaint?.position.set(by[0]!, by[1]!, 0);
  }

  /** Show something of its own, in physics' axes, until it is removed. */
  add(object: Object3D): void {
    this.stage.root.add(object);
    this.#objects.push(object);
  }

  remove(object: Object3D): void {
    this.stage.root.remove(object);
    this.#objects.splice(this.#objects.indexOf(object), 1);
  }

  /** The middle of the body, in three.js' axes. */
  get focus(): Vector3 {
    return this.#focus;
  }

  dispose(): void {
    this.showSchool(null);
    for (const view of [this.#crowd, this.#walkers]) {
      if (view) {
        this.stage.root.remove(view.object);
        view.dispose();
      }
    }
    this.stage.root.remove(...this.#objects);
    this.#body.dispose();
    this.#ghost.dispose();
    this.#scenery.dispose();
    this.camera.dispose();
  }

  #shadowGround(): ShadowGround {
    return { height: this.#groundHeight, sun: this.#scenery.atmosphere.sunDirection, size: this.size };
  }

  // From where a leap is seen [m]; null while there is none.
  #heightForLeap(): number | null {
    const { waterline } = this.#scenery;
    if (waterline === undefined || this.#high < waterline + EMERGED * this.size) {
      return null;
    }
    return waterline + OVER_WATER * this.size;
  }

  // How the body is turned, in three.js' axes: Y is up where physics' Z is.
  #turn(): Quaternion {
    const bone = this.bones[0] ?? 0;
    const turn = toQuaternion(this.pose.orientations.subarray(4 * bone, 4 * bone + 4));
    return new Quaternion(turn.x, turn.z, -turn.y, turn.w);
  }

  // The side of a cloth that is struck [rad]: what strikes it should be seen. What holds it is behind it instead.
  #faceOf(surface: Surface): number {
    const face = facing(surface);
    const striking = this.bones.find((bone) => this.facts.skeleton[bone]!.shapes.length > 0);
    if (striking === undefined) {
      return face;
    }
    const [x, y] = toPhysics(this.#focus);
    const [strikerX, strikerY] = this.bonePoint(striking);
    const ahead = Math.cos(face) * (strikerX - x) + Math.sin(face) * (strikerY - y);
    const isHolder = this.facts.skeleton[striking]!.joints[0]?.entry === surface.placement.position;
    return ahead < 0 === isHolder ? face : face + Math.PI;
  }

  #pose(state: ArrayLike<number>): void {
    poseBones(this.facts.skeleton, state, this.pose);
    if (this.#surface) {
      this.#frame = surfaceFrame(this.#surface, state);
    }
  }

  #locate(): void {
    if (this.#surface) {
      this.#locateSurface(this.#surface.box);
      return;
    }
    const extent = extentOf(this.facts.skeleton, this.bones, this.pose);
    this.#focus.copy(this.#fixedFocus ?? toThree(extent.middle));
    this.#low = extent.low;
    this.#high = extent.high;
    this.#heading = this.#headingOf();
  }

  // What strikes a cloth comes and goes; the cloth is looked at where it hangs.
  #locateSurface(box: Box): void {
    const corners = cornersOf(box).map((corner) => inWorld(this.#frame, corner));
    const heights = corners.map((corner) => corner[2]);
    const middle = [0, 1, 2].map((axis) => corners.reduce((sum, corner) => sum + corner[axis]! / 8, 0));
    this.#focus.copy(toThree(middle));
    this.#low = Math.min(...heights);
    this.#high = Math.max(...heights);
  }

  // A camera that went up and down with what bounces would show it standing still.
  #aim(): void {
    this.#lookAt.copy(this.#focus);
    if (this.#isTumbling) {
      const height = this.#scenery.ground + THROWN_HEIGHT * this.size;
      this.#lookAt.y = Math.max(height, this.#focus.y - THROWN_HEIGHT * this.size);
    }
  }

  // Where the body points [rad]: by the bone in the middle of a skin, else by the first that moves freely.
  #headingOf(): number {
    const bones = this.facts.skeleton;
    const isFree = bones[this.bones[0]!]?.joints[0]?.kind === "free";
    const isBetweenPoints = isSkinnedPoints(this.facts);
    if ((!isFree && !isBetweenPoints) || this.#isTumbling) {
      return 0;
    }
    const bone = isBetweenPoints ? this.bones[Math.floor(this.bones.length / 2)]! : this.bones[0]!;
    const [w, x, y, z] = Array.from(this.pose.orientations.subarray(4 * bone, 4 * bone + 4));
    return Math.atan2(2 * (x! * y! + w! * z!), 1 - 2 * (y! * y! + z! * z!));
  }
}

function makeScenery(stage: Stage, facts: Bundle, measure: Measure, isDark: boolean): Scenery {
  switch (facts.scene.kind) {
    case "water":
      return makeWater(stage, measure, facts.scene.surface);
    case "lot":
      return makeLot(stage);
    case "moon":
      return makeMoon(stage, measure);
    case "plain":
      return makePlain(stage, measure, facts.scene.floor, isDark);
  }
}

/** Return where the sun stands for a cloth that shows its face to an azimuth [rad], in three.js' axes. */
function sunFor(face: number): Vector3 {
  const { azimuth, elevation } = CLOTH_SUN;
  const level = Math.cos(elevation);
  return toThree([level * Math.cos(face + azimuth), level * Math.sin(face + azimuth), Math.sin(elevation)]);
}

function longestSide({ low, high }: Box): number {
  return Math.max(...low.map((value, axis) => high[axis]! - value));
}

/** Return whether a state is one to be drawn: all numbers finite, and none beyond reason. */
export function isDrawable(state: ArrayLike<number>): boolean {
  for (let i = 0; i < state.length; i++) {
    if (!(Math.abs(state[i]!) < MAX_NUMBER)) {
      return false;
    }
  }
  return true;
}
