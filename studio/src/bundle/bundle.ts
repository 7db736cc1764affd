// The contents of a bundle of one emulator: its facts, its skeleton and skin, its scenery and motions.

import { fetchOwn } from "../server/token";
import { sizeOf, type Layout } from "./layout";

export type Vector3 = readonly [number, number, number];
export type Quaternion = readonly [w: number, x: number, y: number, z: number];
export type Pairs = readonly (readonly [number, number])[];
export type Weights = readonly (readonly [entry: number, weight: number])[];

export interface Joint {
  readonly kind: "hinge" | "slide" | "ball" | "free";
  readonly entry: number;
  readonly axis: Vector3;
  readonly anchor: Vector3;
  readonly reference: number;
}

export interface Shape {
  readonly kind: "capsule" | "box" | "sphere" | "ellipsoid" | "cylinder";
  readonly size: readonly number[];
  readonly position: Vector3;
  readonly orientation: Quaternion;
  readonly colour: readonly [number, number, number, number];
}

export interface Binding {
  readonly position: Weights;
  readonly forward: Weights;
  readonly up: Weights;
}

export interface Bone {
  readonly name: string;
  readonly parent: number;
  readonly offset: Vector3;
  readonly orientation: Quaternion;
  readonly joints: readonly Joint[];
  readonly shapes: readonly Shape[];
  readonly binding?: Binding | null;
  /** Reach of the part of a model's skin that follows it, from its origin [m]. */
  readonly reach?: number;
}

/** A skin of a MuJoCo model: triangles whose vertices follow up to four bones each (appearance/mesh_skin.py). */
export interface MeshSkin {
  readonly kind: "mesh";
  /** Bones that vertices follow, and their pose when the skin was made. */
  readonly bones: readonly { readonly number: number; readonly position: Vector3; readonly orientation: Quaternion }[];
  /** Triangles of one colour (sRGB), after those of the part before. */
  readonly parts: readonly { readonly name: string; readonly colour: Vector3; readonly triangles: number }[];
  readonly lowest: Vector3;
  readonly step: number;
  /** Uint16 (V, 3) in base64: coordinates in steps from `lowest`. */
  readonly vertices: string;
  /** Uint16 (M, 3). */
  readonly triangles: string;
  /** Uint8 (V, 4): indices into `bones`. */
  readonly influences: string;
  /** Uint8 (V, 4): weights, which add up to 255. */
  readonly weights: string;
}

/** The skin of a body of mass points at rest, each array in base64. */
export interface SkinArrays {
  readonly kind?: undefined;
  readonly positions: string;
  readonly normals: string;
  readonly uvs?: string;
  /** Parts of the skin by name: body, fin, eye; indices are sorted by part. */
  readonly parts?: readonly (readonly [name: string, firstIndex: number, indices: number])[];
  readonly colours: string;
  readonly indices: string;
  readonly bones: string;
  readonly weights: string;
}

/** State entries of the position and rotation of a frame; -1 for those that do not exist (state/placement.py). */
export interface Placement {
  /** First entry of its origin [m]. */
  readonly position: number;
  /** Entry of its heading about Z [rad]. */
  readonly heading: number;
  /** First entry of its quaternion. */
  readonly orientation: number;
}

/** The surface of a soft body: nodes, and shapes added to them by amplitude; each array in base64. */
export interface SurfaceArrays {
  /** Float32 (N, 3): positions of the nodes in their own frame at zero amplitudes [m]. */
  readonly mean: string;
  /** Int16 (K, N, 3): displacement of the nodes by each amplitude, in units of its scale. */
  readonly modes: string;
  /** Float32 (K). */
  readonly scales: string;
  /** Uint32 (F, 3): corners of the triangles, counterclockwise from outside. */
  readonly faces: string;
  /** State entry of the first amplitude [m]. */
  readonly first: number;
  readonly placement: Placement;
  /** sRGB. */
  readonly colour: Vector3;
  /** Float32 (N, 3): sRGB of the nodes, if they differ. */
  readonly colours?: string | null;
}

/** A mover: `size` numbers from `entry` on are its position [m] and, if it turns, heading [rad]; its controls are their rates. */
export type MoverFacts = readonly [name: string, entry: number, control: number, size: number];

/** A parameter of a family of bodies: one number of a state, which no motion changes. */
export interface ParameterFacts {
  readonly name: string;
  readonly unit: string;
  /** Ends of the trained range. */
  readonly low: number;
  readonly high: number;
  readonly entry: number;
  /** Displacement of mass points at rest along the body's axes, per unit of it [m]; empty without mass points. */
  readonly growth: readonly Vector3[];
}

/** A usual motion: controls middle + half width · amplitude · sin(2π t / period - lag). */
export interface GaitFacts {
  readonly period: number;
  readonly amplitudes: readonly number[];
  readonly lags: readonly number[];
}

export type SceneKind = "water" | "lot" | "moon" | "meadow" | "hall" | "table" | "plain";

export interface SceneFacts {
  readonly kind: SceneKind;
  readonly surface: number | null;
  readonly floor: number | null;
}

export type CommandPart = readonly [name: string, unit: string, low: number, high: number];

export interface PolicyFacts {
  readonly wasm: string;
  readonly command: readonly CommandPart[];
  /** Phase by which its clock advances in a super step [rad]; null for a policy whose clock and commands are in the state. */
  readonly phase_per_step: number | null;
}

export interface DefaultMotion {
  readonly start: readonly number[];
  readonly controls: readonly (readonly number[])[];
  readonly pushes?: readonly Push[];
}

/** A push by a user: before super step `step`, `change` (S) is added to the state. */
export type Push = readonly [step: number, change: readonly number[]];

/** A movable place of a goal: the first of its three entries, if any, and its position [m]. */
export interface MovablePlace {
  readonly kind: "place";
  readonly entry: number | null;
  readonly at: Vector3;
}

/** A goal of control: a final state, or a place to reach. */
export interface Goal {
  readonly name: string;
  readonly kind: "state" | "place";
  readonly seconds: number;
  readonly start: readonly number[];
  readonly target: readonly number[] | null;
  readonly is_at_start?: boolean;
  readonly movable: MovablePlace | null;
  /** For a state: [entry, value, tolerance] of each number that counts; for a place: the tolerance [m]. */
  readonly within: readonly (readonly [number, number, number])[] | { readonly distance: number };
}

/** How position, velocity and directions of the whole body are read from a state. */
export type Root =
  | { readonly kind: "free"; readonly position: number; readonly orientation: number; readonly velocity: number }
  | {
      readonly kind: "points";
      readonly position: Weights;
      readonly velocity: Weights;
      readonly forward: Weights;
      readonly up: Weights;
    };

/** Recorded falls of a walking body on the physics, each until it stands again. */
export interface FallFacts {
  /** Time from one state to the next [s]. */
  readonly dt: number;
  /** State entry of the commanded heading [rad]. */
  readonly heading: number;
  /** Float32 (T, S) in base64. */
  readonly motions: readonly string[];
}

export interface Bundle {
  readonly id: string;
  readonly system: string;
  /** Its title, if there are several of one system. */
  readonly title?: string;
  readonly about: string;
  /** How good the emulator is where it was trained; null if its file does not say, undefined for physics. */
  readonly verdict?: { readonly word: string; readonly reasons: string } | null;
  /** What makes its super steps: an emulator, or the physics itself if that costs less. */
  readonly model?: "emulator" | "physics";
  readonly dt: number;
  readonly physics_dt: number;
  readonly substeps: number;
  readonly latent: number;
  readonly sha256: string;
  readonly state: Layout;
  readonly control: Layout;
  /** Unit of each number of a control; 1 for a share. */
  readonly control_units?: readonly string[];
  readonly control_low: readonly number[];
  readonly control_high: readonly number[];
  readonly rest: readonly number[];
  readonly rates: Pairs;
  readonly orientations: Pairs;
  readonly skeleton: readonly Bone[];
  readonly skin: SkinArrays | MeshSkin | null;
  /** Surface of a soft body; null or undefined for anything else. */
  readonly surface?: SurfaceArrays | null;
  /** Movers of a soft body, which hold or strike it. */
  readonly movers?: readonly MoverFacts[];
  /** Parameters of a family of bodies. */
  readonly parameters?: readonly ParameterFacts[];
  readonly gait?: GaitFacts | null;
  readonly root: Root | null;
  readonly scene: SceneFacts;
  readonly policy: PolicyFacts | null;
  readonly falls?: FallFacts;
  readonly default_motion: DefaultMotion;
  readonly goals: readonly Goal[];
  readonly emulator: string;
  readonly can_simulate?: boolean;
  /** File of the true physics, beside `bundle.json`, if there is one: a page without a server runs it. */
  readonly physics?: string | null;
  readonly descents: readonly unknown[];
}

/** Return whether a bundle was made of a user's file: its id is then the hash of that. */
export function isOwn(id: string): boolean {
  return /^[0-9a-f]{16}$/.test(id);
}

/** Return what people call a bundle: by its title if its id says nothing. */
export function nameOf({ id, title, system }: { readonly id: string; readonly title?: string; readonly system: string }): string {
  return isOwn(id) ? (title ?? system) : id;
}

/** Return whether the page runs the true physics of a bundle, with nothing to doubt or to compare with. */
export function isPhysics(facts: Bundle): boolean {
  return facts.model === "physics";
}

/** Return whether a skin is that of a MuJoCo model, whose bones have joints. */
export function isMeshSkin(skin: SkinArrays | MeshSkin | null): skin is MeshSkin {
  return skin?.kind === "mesh";
}

/** Return whether a bundle has mass points under a skin. */
export function isSkinnedPoints(facts: Bundle): boolean {
  return facts.skin !== null && !isMeshSkin(facts.skin);
}

/** Return whether a bundle has a soft body on solid ground, which may be thrown and tumble, and has no front. */
export function isTumbling(facts: Bundle): boolean {
  return isSkinnedPoints(facts) && facts.scene.kind !== "water";
}

/** Return whether a bundle has a body that walks on command: its policy's commands are in its state. */
export function isWalking(facts: Bundle): boolean {
  return facts.policy?.phase_per_step === null;
}

/** A bundle and the address of its folder. */
export interface LoadedBundle {
  readonly facts: Bundle;
  readonly folder: URL;
}

/** Fetch `bundle.json` of a folder; the error names the fault. */
export async function loadBundle(folder: URL): Promise<LoadedBundle> {
  const response = await fetchOwn(new URL("bundle.json", folder));
  const facts = (await response.json()) as Bundle;
  checkBundle(facts);
  return { facts, folder };
}

/** Throw an Error that names an inconsistency in a bundle. */
export function checkBundle(facts: Bundle): void {
  const stateSize = sizeOf(facts.state);
  const controlSize = sizeOf(facts.control);
  wantedSize("rest", facts.rest.length, stateSize);
  wantedSize("control_low", facts.control_low.length, controlSize);
  wantedSize("control_high", facts.control_high.length, controlSize);
  wantedSize("default_motion.start", facts.default_motion.start.length, stateSize);
  for (const control of facts.default_motion.controls) {
    wantedSize("default_motion.controls", control.length, controlSize);
  }
  if (!(facts.dt > 0)) {
    throw new Error(`dt: wanted more than 0 s, got ${facts.dt}`);
  }
  facts.skeleton.forEach((bone, number) => {
    if (!(bone.parent < number)) {
      throw new Error(`bone '${bone.name}' comes before the bone it hangs from`);
    }
  });
}

function wantedSize(name: string, given: number, wanted: number): void {
  if (given !== wanted) {
    throw new Error(`${name}: wanted ${wanted} numbers, got ${given}`);
  }
}
