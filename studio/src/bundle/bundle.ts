// What a bundle says about one emulator: its facts, its skeleton and skin, where it lives and what it can show.

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
  /** How far what follows it of a model's skin reaches from its origin [m]. */
  readonly reach?: number;
}

/** A skin of a MuJoCo model: triangles whose vertices follow up to four bones each (appearance/mesh_skin.py). */
export interface MeshSkin {
  readonly kind: "mesh";
  /** Bones that vertices follow, and where they are in the pose that the skin was made in. */
  readonly bones: readonly { readonly number: number; readonly position: Vector3; readonly orientation: Quaternion }[];
  /** Triangles of one colour (sRGB), those after the part before. */
  readonly parts: readonly { readonly name: string; readonly colour: Vector3; readonly triangles: number }[];
  readonly lowest: Vector3;
  readonly step: number;
  /** Uint16 (V, 3) in base64: coordinates in steps from `lowest`. */
  readonly vertices: string;
  /** Uint16 (M, 3). */
  readonly triangles: string;
  /** Uint8 (V, 4): places in `bones`. */
  readonly influences: string;
  /** Uint8 (V, 4): weights, of 255 together. */
  readonly weights: string;
}

/** The skin of a body of mass points at rest, each array in base64. */
export interface SkinArrays {
  readonly kind?: undefined;
  readonly positions: string;
  readonly normals: string;
  readonly uvs?: string;
  /** Parts of the skin by what they are: body, fin, eye; indices are sorted by part. */
  readonly parts?: readonly (readonly [name: string, firstIndex: number, indices: number])[];
  readonly colours: string;
  readonly indices: string;
  readonly bones: string;
  readonly weights: string;
}

/** State entries that say where a frame is and how it is turned; -1 where they do not say (state/placement.py). */
export interface Placement {
  /** Where its origin begins [m]. */
  readonly position: number;
  /** How far it is turned about Z [rad]. */
  readonly heading: number;
  /** Where its quaternion begins. */
  readonly orientation: number;
}

/** The surface of a soft body: nodes, and shapes that are added to them by their amplitudes; each array in base64. */
export interface SurfaceArrays {
  /** Float32 (N, 3): where the nodes are, in their own frame, if every amplitude is zero [m]. */
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
}

/** What a user moves: `size` numbers from `entry` on are its position [m] and, if it turns, its heading [rad]; as many controls their rates. */
export type MoverFacts = readonly [name: string, entry: number, control: number, size: number];

/** What varies over a family of bodies: one number of a state, which no motion changes. */
export interface ParameterFacts {
  readonly name: string;
  readonly unit: string;
  /** Ends of the range that was trained. */
  readonly low: number;
  readonly high: number;
  readonly entry: number;
  /** By how much mass points at rest lie elsewhere along the body's axes, per unit of it [m]; empty where there are none. */
  readonly growth: readonly Vector3[];
}

/** A usual motion: controls middle + half width · amplitude · sin(2π t / period - lag). */
export interface GaitFacts {
  readonly period: number;
  readonly amplitudes: readonly number[];
  readonly lags: readonly number[];
}

export type SceneKind = "water" | "lot" | "moon" | "plain";

export interface SceneFacts {
  readonly kind: SceneKind;
  readonly surface: number | null;
  readonly floor: number | null;
}

export type CommandPart = readonly [name: string, unit: string, low: number, high: number];

export interface PolicyFacts {
  readonly wasm: string;
  readonly command: readonly CommandPart[];
  /** What its clock gains with a super step [rad]; null of a policy whose clock and commands are in the state. */
  readonly phase_per_step: number | null;
}

export interface DefaultMotion {
  readonly start: readonly number[];
  readonly controls: readonly (readonly number[])[];
  readonly pushes?: readonly Push[];
}

/** Somebody's hand: before super step `step`, `change` (S) is added to the state. */
export type Push = readonly [step: number, change: readonly number[]];

/** A place of a goal that may be moved: the first of three entries it stands in, if any, and where it is [m]. */
export interface MovablePlace {
  readonly kind: "place";
  readonly entry: number | null;
  readonly at: Vector3;
}

/** A goal of control: a state to be in at the end, or a place to be at. */
export interface Goal {
  readonly name: string;
  readonly kind: "state" | "place";
  readonly seconds: number;
  readonly start: readonly number[];
  readonly target: readonly number[] | null;
  readonly is_at_start?: boolean;
  readonly movable: MovablePlace | null;
  /** Of a state: [entry, value, tolerance] of each number that counts; of a place: how near is near enough [m]. */
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

export interface Bundle {
  readonly id: string;
  readonly system: string;
  readonly about: string;
  /** How good the emulator is where it was trained; null where its file does not tell, undefined of physics. */
  readonly verdict?: { readonly word: string; readonly reasons: string } | null;
  /** What makes its super steps: an emulator, or the physics itself where that costs less. */
  readonly model?: "emulator" | "physics";
  readonly dt: number;
  readonly physics_dt: number;
  readonly substeps: number;
  readonly latent: number;
  readonly sha256: string;
  readonly state: Layout;
  readonly control: Layout;
  readonly control_low: readonly number[];
  readonly control_high: readonly number[];
  readonly rest: readonly number[];
  readonly rates: Pairs;
  readonly orientations: Pairs;
  readonly skeleton: readonly Bone[];
  readonly skin: SkinArrays | MeshSkin | null;
  /** Of a soft body; null or undefined of anything else. */
  readonly surface?: SurfaceArrays | null;
  /** What moves a soft body, and strikes it. */
  readonly movers?: readonly MoverFacts[];
  /** Of a family of bodies. */
  readonly parameters?: readonly ParameterFacts[];
  readonly gait?: GaitFacts | null;
  readonly root: Root | null;
  readonly scene: SceneFacts;
  readonly policy: PolicyFacts | null;
  readonly default_motion: DefaultMotion;
  readonly goals: readonly Goal[];
  readonly emulator: string;
  readonly can_simulate?: boolean;
  /** File of the true physics, beside `bundle.json`, where there is one: a page without a server runs it. */
  readonly physics?: string | null;
  readonly descents: readonly unknown[];
}

/** Return whether the page runs the true physics of a bundle: there is nothing to doubt, and nothing to compare it with. */
export function isPhysics(facts: Bundle): boolean {
  return facts.model === "physics";
}

/** Return whether a skin is that of a MuJoCo model, whose bones have joints. */
export function isMeshSkin(skin: SkinArrays | MeshSkin | null): skin is MeshSkin {
  return skin?.kind === "mesh";
}

/** Return whether a bundle is of mass points under a skin. */
export function isSkinnedPoints(facts: Bundle): boolean {
  return facts.skin !== null && !isMeshSkin(facts.skin);
}

/** Return whether a bundle is of a soft body on solid ground, which may be thrown and tumble: no side of it is its front. */
export function isTumbling(facts: Bundle): boolean {
  return isSkinnedPoints(facts) && facts.scene.kind === "plain";
}

/** Return whether a bundle is of a body that walks on command: its policy's commands are in its state. */
export function isWalking(facts: Bundle): boolean {
  return facts.policy?.phase_per_step === null;
}

/** A bundle and the address of its folder. */
export interface LoadedBundle {
  readonly facts: Bundle;
  readonly folder: URL;
}

/** Fetch `bundle.json` of a folder; the error says what is wrong with it. */
export async function loadBundle(folder: URL): Promise<LoadedBundle> {
  const address = new URL("bundle.json", folder);
  const response = await fetch(address);
  if (!response.ok) {
    throw new Error(`${address.pathname}: ${response.status} ${response.statusText}`);
  }
  const facts = (await response.json()) as Bundle;
  checkBundle(facts);
  return { facts, folder };
}

/** Throw an Error that names what in a bundle does not fit together. */
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
    throw new Error(`dt: wanted more than 0 s, came ${facts.dt}`);
  }
  facts.skeleton.forEach((bone, number) => {
    if (!(bone.parent < number)) {
      throw new Error(`bone '${bone.name}' comes before the bone it hangs from`);
    }
  });
}

function wantedSize(name: string, came: number, wanted: number): void {
  if (came !== wanted) {
    throw new Error(`${name}: wanted ${wanted} numbers, came ${came}`);
  }
}
