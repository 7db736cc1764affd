// Everything visible of one system: scenery, the body, its ghost, and the camera.

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
import { makeMeadow } from "./meadow";
import { makeRoom } from "./room";
import { makeCrowdView, type CrowdView } from "./crowd";
import { makeWalkersView, type WalkersView } from "./walkers";
import { makeFoodView, type FoodView } from "./food";
import { makeFleshSchool } from "./flesh_school";
import { makeSchoolView, type SchoolView } from "./school";
import type { ShadowGround } from "./school_shadows";
import type { Crowd } from "../steering/crowd";
import { SMALL, type Life } from "../steering/life";
import type { Room, School } from "../steering/school";
import { RADIUS as WALKERS_RADIUS, type Walkers } from "../steering/walkers";
import type { Measure, Scenery } from "./scenery";
import type { Atmosphere, PictureSize, Stage } from "./stage";
import { makeWater } from "./water/water";

/** Half the width of the shadowed area, over the body's size. */
const SHADOW_REACH = 2.6;

/** Initial view: to the side of the body, from slightly above or, under water, below [rad]. */
interface View {
  readonly azimuth: number;
  readonly elevation: number;
  /** Distance, over the body's size. */
  readonly distance: number;
}

const ROOM_VIEW: View = { azimuth: -1.35, elevation: 0.1, distance: 2.2 };

const VIEWS: Record<Bundle["scene"]["kind"], View> = {
  water: { azimuth: -1.05, elevation: 0.12, distance: 2.5 },
  lot: { azimuth: 0.85, elevation: 0.3, distance: 2.5 },
  moon: { azimuth: 0.7, elevation: 0.16, distance: 3.4 },
  meadow: ROOM_VIEW,
  hall: ROOM_VIEW,
  table: ROOM_VIEW,
  plain: ROOM_VIEW,
};

/** View of a hanging body, with room all around: it may swing up. */
const HUNG_VIEW: View = { ...ROOM_VIEW, distance: 3 };

/** View of a thrown body, from further away, and height of the camera over the ground while it bounces; over its size. */
const THROWN_VIEW: View = { azimuth: -1.1, elevation: 0.2, distance: 5.2 };
const THROWN_HEIGHT = 1.1;

/** View of a cloth, relative to its face [rad], and from slightly above. */
const CLOTH_VIEW: View = { azimuth: -0.7, elevation: 0.18, distance: 2.4 };

/** Direction of the sun for a cloth, on the other side of its face, so that folds are visible [rad]. */
const CLOTH_SUN = { azimuth: 0.75, elevation: 0.75 };

/** Depth of the ground under a cloth without one, over its size: colliders may come lower. */
const UNDER_CLOTH = 0.25;

/** Viewing distance of a shark among small fish, over its size. */
const LIFE_DISTANCE = 4.5;

/** Viewing distance of a school, and how far one then sees, over its radius; and elevation [rad]: the camera stays in the water. */
const SCHOOL_DISTANCE = 1.9;
const SCHOOL_SIGHT = 5;
const SCHOOL_ELEVATION = 0.06;

/** View of a walker, from behind and slightly aside; with others around it from further away and higher up. */
const WALKER_VIEW: View = { azimuth: 2.7, elevation: 0.16, distance: 2.3 };
const AMONG_WALKERS: View = { azimuth: 2.7, elevation: 0.42, distance: 6 };

/** Viewing distance of a crowd, over the distance of its outermost bodies, and elevation [rad]. */
const CROWD_DISTANCE = 1.8;
const CROWD_ELEVATION = 0.42;

/** Largest number of a state that is drawn [m, rad, …]: beyond it, it is lost. */
const MAX_NUMBER = 1e5;

/** Height out of the water at which a body leaps, and height from which it is then seen; over its size. */
const EMERGED = 0.1;
const OVER_WATER = 0.3;

/** Level part of a body's forward direction below which it has no heading. */
const LEVEL = 0.5;

/** Maximum distance from a bone at which a swimmer is grabbed, over its size. */
const GRIP = 0.12;

/** Minimum distance at which a mover is grabbed, over the body's size, however small it is: fingers are not precise. */
const MOVER_GRIP = 0.06;

/** A grabbed point of a body, in the world [m]. */
export interface Grip {
  readonly bone: number;
  readonly point: [number, number, number];
}

export class World {
  readonly size: number;
  readonly camera: CameraRig;
  readonly pose: Pose;
  /** Whether the camera stays fixed: otherwise users would never catch up with what they drag. */
  isCameraHeld = false;
  /** The bones that move. */
  readonly bones: number[];
  readonly #body: BodyView;
  readonly #ghost: BodyView;
  readonly ghostPose: Pose;
  readonly #scenery: Scenery;
  readonly #atmosphere: Atmosphere;
  /** Heading from which a surface shows its face [rad]. */
  readonly #face: number;
  readonly #focus = new Vector3();
  /** The look-at point of the camera: the body, or for a bouncing one its position along the ground. */
  readonly #lookAt = new Vector3();
  readonly #isTumbling: boolean;
  readonly #surface: Surface | null;
  readonly #colliders: readonly Collider[];
  /** Pose of the surface's own frame. */
  #frame: Frame = { origin: [0, 0, 0], turn: [1, 0, 0, 0] };
  readonly #objects: Object3D[];
  #fixedFocus: Vector3 | null = null;
  #school: SchoolView | null = null;
  /** The school around the body, all of which is in view; null without one, and among small fish. */
  #schooling: School | null = null;
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
      // A hanging body may start higher than it will ever be again.
      low: VIEWS[facts.scene.kind] === ROOM_VIEW ? Math.min(this.#low, lowAtRest) - this.#depthBelow : this.#low,
      high: this.#high,
    };
    this.#face = this.#surface ? this.#faceOf(this.#surface) : 0;
    const sun = this.#surface ? sunFor(this.#face) : undefined;
    this.#scenery = makeScenery(stage, facts, measure, isDark, sun);
    const mount = makeMount(facts, this.#scenery.ground, this.size);
    this.#body = makeBody(facts, this.size, this.#focus, this.#scenery.bodyPatches);
    this.#ghost = makeGhost(facts, this.size);
    this.#ghost.object.visible = false;
    this.#objects = [this.#body.object, this.#ghost.object];
    if (mount) {
      this.#objects.push(mount.object);
      // The camera looks at the hinge of a hanging body: following it, the camera would swing.
      this.#fixedFocus = toThree(mount.pivot);
      this.#locate();
    }
    for (const still of [this.#body.scenery, this.#body.goalPaint]) {
      if (still) {
        this.#objects.push(still);
      }
    }
    stage.root.add(...this.#objects);
    this.#atmosphere = sun ? { ...this.#scenery.atmosphere, sunDirection: sun } : this.#scenery.atmosphere;
    stage.light(this.#atmosphere, SHADOW_REACH * this.size);
    this.camera = new CameraRig(stage.camera, stage.canvas);
    if (isWalking(facts)) {
      this.camera.mode = "chase";
    }
    this.home();
  }

  /** Bring the camera back to its initial view. */
  home(): void {
    const view = this.#view();
    this.#aim();
    this.camera.frame(this.#lookAt, this.size, this.#heading, view.azimuth, view.elevation, view.distance);
  }

  /** Additional depth under the body at rest of a ground of unknown height [m]. */
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
    if (this.#schooling) {
      const elevation = this.#scenery.waterline === undefined ? SCHOOL_ELEVATION : 0;
      return { ...view, elevation, distance: (SCHOOL_DISTANCE * this.#schooling.radius) / this.size };
    }
    return this.#food ? { ...view, distance: LIFE_DISTANCE } : view;
  }

  /** Show the body in `state` (S); for a lost state the last good pose stays, and false is returned. */
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

  /** Doubt of the body, 0 to 1. */
  set doubt(share: number) {
    this.#body.doubt.value = share;
  }

  /** The middle of the body [m]. */
  get middle(): [number, number, number] {
    return toPhysics(this.#focus);
  }

  /** Range of heights to swim in [m]. */
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
    this.#schooling = school && scale === 1 ? school : null;
    const { bodyPatches } = this.#scenery;
    this.#school =
      school &&
      (this.facts.surface
        ? makeFleshSchool(this.facts, school, this.size, bodyPatches)
        : makeSchoolView(this.facts, school, this.#shadowGround(), bodyPatches, scale));
    if (this.#school) {
      this.stage.root.add(this.#school.object);
    }
    this.#scenery.see?.(SCHOOL_SIGHT * (this.#schooling?.radius ?? 0));
    this.home();
  }

  /** Draw small fish and their food around the body, seen from further away. */
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

  /** Draw a crowd around the body, or none, with all of it in view. */
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

  /** Draw others who walk around the body, or none, with all of them in view. */
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

  /** Show walker `number` in `state` (S). */
  showWalker(number: number, state: Float32Array): void {
    this.#walkers?.show(number, state);
  }

  /** Show body `number` of the crowd in `state` (S). */
  showInCrowd(number: number, state: Float32Array): void {
    this.#crowd?.show(number, state);
  }

  /** Draw an image. `controls` are shares of their bounds, 0 to 1; scenery stands still with reduced motion. */
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

  /** Let the camera follow the body for `seconds`; with infinity it catches up. */
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

  /** The foremost mover under the pointer, by the number of its bone among `bones`; null if there is none. */
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

  // The point where a ray hits the shapes of a bone, or else comes nearest to its spheres and capsules, or to the bone if it has
  // none; null if it misses them.
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

  /** The pointer's position on the plane through `point` [m] that faces the camera, or is level. */
  dragPoint(x: number, y: number, point: ArrayLike<number>, isLevel: boolean): [number, number, number] | null {
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(x, y), this.stage.camera);
    const normal = isLevel ? new Vector3(0, 1, 0) : this.stage.camera.getWorldDirection(new Vector3());
    const plane = new Plane().setFromNormalAndCoplanarPoint(normal, toThree(point));
    const hit = ray.ray.intersectPlane(plane, new Vector3());
    return hit && toPhysics(hit);
  }

  /** Current position of bone `number` [m]. */
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

  /** Displace the goal's paint from its initial position [m]. */
  moveGoalPaint(by: ArrayLike<number>): void {
    this.#body.goalPaint?.position.set(by[0]!, by[1]!, 0);
  }

  /** Show another object, in physics' axes, until it is removed. */
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

  // Height from which a leap is seen [m]; null without a leap.
  #heightForLeap(): number | null {
    const { waterline } = this.#scenery;
    if (waterline === undefined || this.#schooling || this.#high < waterline + EMERGED * this.size) {
      return null;
    }
    return waterline + OVER_WATER * this.size;
  }

  // Rotation of the body, in three.js' axes: Y is up instead of physics' Z.
  #turn(): Quaternion {
    const bone = this.bones[0] ?? 0;
    const turn = toQuaternion(this.pose.orientations.subarray(4 * bone, 4 * bone + 4));
    return new Quaternion(turn.x, turn.z, -turn.y, turn.w);
  }

  // The side of a cloth that is struck [rad], so that colliders are visible; movers that hold it are behind it.
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

  // Colliders of a cloth come and go; the camera looks at the cloth where it hangs.
  #locateSurface(box: Box): void {
    const corners = cornersOf(box).map((corner) => inWorld(this.#frame, corner));
    const heights = corners.map((corner) => corner[2]);
    const middle = [0, 1, 2].map((axis) => corners.reduce((sum, corner) => sum + corner[axis]! / 8, 0));
    this.#focus.copy(toThree(middle));
    this.#low = Math.min(...heights);
    this.#high = Math.max(...heights);
  }

  // A camera that followed a bouncing body up and down would show it at rest.
  #aim(): void {
    this.#lookAt.copy(this.#schooling ? toThree(this.#schooling.middle) : this.#focus);
    if (this.#isTumbling) {
      const height = this.#scenery.ground + THROWN_HEIGHT * this.size;
      this.#lookAt.y = Math.max(height, this.#focus.y - THROWN_HEIGHT * this.size);
    }
  }

  // Heading of the body [rad]: that of the bone in the middle of a skin, else of the first that moves freely.
  #headingOf(): number {
    const bones = this.facts.skeleton;
    const isFree = bones[this.bones[0]!]?.joints[0]?.kind === "free";
    const isBetweenPoints = isSkinnedPoints(this.facts);
    if ((!isFree && !isBetweenPoints) || this.#isTumbling) {
      return 0;
    }
    const bone = isBetweenPoints ? this.bones[Math.floor(this.bones.length / 2)]! : this.bones[0]!;
    const [w, x, y, z] = Array.from(this.pose.orientations.subarray(4 * bone, 4 * bone + 4));
    const [ahead, aside] = [1 - 2 * (y! * y! + z! * z!), 2 * (x! * y! + w! * z!)];
    // A body that lies on its front or back heads nowhere.
    return Math.hypot(ahead, aside) < LEVEL ? this.#heading : Math.atan2(aside, ahead);
  }
}

/** `sun` is its direction in three.js' axes, unless the place has its own. */
function makeScenery(stage: Stage, facts: Bundle, measure: Measure, isDark: boolean, sun: Vector3 | undefined): Scenery {
  switch (facts.scene.kind) {
    case "water":
      return makeWater(stage, measure, facts.scene.surface);
    case "lot":
      return makeLot(stage);
    case "moon":
      return makeMoon(stage, measure);
    case "meadow":
      return makeMeadow(stage, measure, facts.scene.floor, sun);
    default:
      return makeRoom(facts.scene.kind, stage, measure, facts.scene.floor, isDark);
  }
}

/** Return the direction of the sun for a cloth that faces an azimuth [rad], in three.js' axes. */
function sunFor(face: number): Vector3 {
  const { azimuth, elevation } = CLOTH_SUN;
  const level = Math.cos(elevation);
  return toThree([level * Math.cos(face + azimuth), level * Math.sin(face + azimuth), Math.sin(elevation)]);
}

function longestSide({ low, high }: Box): number {
  return Math.max(...low.map((value, axis) => high[axis]! - value));
}

/** Return whether a state can be drawn: all numbers are finite and reasonable. */
export function isDrawable(state: ArrayLike<number>): boolean {
  for (let i = 0; i < state.length; i++) {
    if (!(Math.abs(state[i]!) < MAX_NUMBER)) {
      return false;
    }
  }
  return true;
}
