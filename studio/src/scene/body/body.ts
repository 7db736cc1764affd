// The drawn body: its skin or its bones' shapes, in the colours of its material or as a ghost.

import { Color, Group, Matrix4, Object3D, SRGBColorSpace, type BufferGeometry, type IUniform, type Material, type Mesh, type Vector3 } from "three";
import { isMeshSkin, isTumbling, type Bundle, type Shape, type SurfaceArrays, type Vector3 as Vector3Facts } from "../../bundle/bundle";
import { collidersOf } from "../../body/colliders";
import { isMoved, type Pose } from "../../body/pose";
import { surfaceOf } from "../../body/surface";
import type { Patch } from "../glsl";
import { makeCloth, type ClothKind, type ClothMaterials } from "./cloth";
import { doubtPatch, fittingsMaterial, ghostMaterial, sceneryMaterial, shapeMaterial, sharkPatch, skinMaterial, softMaterial, surfaceMaterial, type Doubt } from "./materials";
import { boneMatrix, makeSkin, skinGeometry, type SkinView } from "./skin";
import { shapeColour, shapeMesh } from "./shapes";

/** Half the side above which a flat box is ground [m]. */
const GROUND = 8;

/** Maximum distance of a goal's paint from the goal [m]. */
const SAME_PLACE = 0.02;

export interface BodyView {
  readonly object: Object3D;
  /** Its fixed parts, such as ground markings; null if there are none. */
  readonly scenery: Object3D | null;
  /** The paint on the ground at the system's only goal, such as the lander's pad, which can be moved; null if there is none. */
  readonly goalPaint: Object3D | null;
  /** Doubt, 0 to 1. */
  readonly doubt: Doubt;
  /** Share of its painting as a shark, 0 to 1; only for a body with a skin. */
  readonly shark?: IUniform<number>;
  /** Show it in a pose, which is that of the state (S). */
  update(pose: Pose, state: ArrayLike<number>): void;
  dispose(): void;
}

/** Return the body of a bundle with its own colours; `focus` is the look-at point, kept up to date by its owner. */
export function makeBody(facts: Bundle, size: number, focus: Vector3, patches: readonly Patch[]): BodyView {
  const doubt: Doubt = { value: 0 };
  const all = [...patches, doubtPatch(doubt)];
  if (facts.skin && !isMeshSkin(facts.skin)) {
    const scales = facts.system === "fish" ? 1 : 0;
    const shark = { value: 0 };
    const material = isTumbling(facts) ? softMaterial(all) : skinMaterial(size, scales, [...all, sharkPatch(shark)]);
    return { ...skinnedBody(facts, skinGeometry(facts.skin), material, doubt), shark };
  }
  const materials = new MaterialKeeper((colour, opacity, isMoving) =>
    isMoving ? shapeMaterial(colour, opacity, all) : sceneryMaterial(colour, focus, patches),
  );
  const shaped = shapedBody(facts, materials, doubt, true);
  if (isMeshSkin(facts.skin)) {
    return withSkin(shaped, skinnedBody(facts, skinGeometry(facts.skin), softMaterial(all), doubt));
  }
  if (!facts.surface) {
    return shaped;
  }
  const colour = surfaceColour(facts.surface);
  const kind = clothKind(facts, size);
  return withCloth(shaped, kind, {
    surface: (nodes) => surfaceMaterial(kind.surface, colour, size, [nodes, ...all]),
    fittings: fittingsMaterial(all),
  });
}

/** Return the kind of cloth of a soft body of `size` [m]. */
export function clothKind(facts: Bundle, size: number): ClothKind {
  return { surface: surfaceOf(facts.surface!), size, colliders: collidersOf(facts.skeleton) };
}

/** Return a surface's linear colour; bundles hold sRGB. */
export function surfaceColour({ colour }: SurfaceArrays): Color {
  return new Color().setRGB(...colour, SRGBColorSpace);
}

/** Return the body's ghost: its moving parts in one colour, by default that of physics. */
export function makeGhost(facts: Bundle, size: number, colour?: Color): BodyView {
  const material = ghostMaterial(size, colour);
  const doubt: Doubt = { value: 0 };
  let ghost = shapedBody(facts, new MaterialKeeper(() => material), doubt, false);
  if (facts.skin) {
    ghost = withSkin(ghost, skinnedBody(facts, skinGeometry(facts.skin), material, doubt));
  }
  if (facts.surface) {
    // A ghost is drawn exactly where physics puts it.
    ghost = withCloth(ghost, { ...clothKind(facts, size), colliders: [] }, { surface: (nodes) => ghostMaterial(size, colour, [nodes]), fittings: null });
  }
  ghost.object.traverse((part) => {
    part.castShadow = false;
    part.receiveShadow = false;
    part.renderOrder = 3;
  });
  return ghost;
}

/** A body of shapes with a skin around it. */
function withSkin(shaped: BodyView, skin: BodyView): BodyView {
  shaped.object.add(skin.object);
  return {
    ...shaped,
    update(pose, state) {
      shaped.update(pose, state);
      skin.update(pose, state);
    },
    dispose() {
      shaped.dispose();
      skin.dispose();
    },
  };
}

/** A body of shapes with a surface among them. */
function withCloth(shaped: BodyView, kind: ClothKind, materials: ClothMaterials): BodyView {
  const cloth = makeCloth(kind, 1, materials);
  shaped.object.add(cloth.object);
  return {
    ...shaped,
    update(pose, state) {
      shaped.update(pose, state);
      cloth.show(0, state, pose);
    },
    dispose() {
      shaped.dispose();
      cloth.dispose();
    },
  };
}

function skinnedBody(facts: Bundle, geometry: BufferGeometry, material: Material, doubt: Doubt): BodyView {
  const skin: SkinView = makeSkin(geometry, material, facts);
  return {
    object: skin.object,
    scenery: null,
    goalPaint: null,
    doubt,
    update: (pose) => skin.update(pose),
    dispose() {
      geometry.dispose();
      material.dispose();
    },
  };
}

function shapedBody(facts: Bundle, materials: MaterialKeeper, doubt: Doubt, withScenery: boolean): BodyView {
  const object = new Group();
  const scenery = new Group();
  const goalPaint = new Group();
  goalPaint.name = "goal";
  const goal = onlyPlace(facts);
  const bones = facts.skeleton.map((bone, number) => {
    const isMoving = isMoved(facts.skeleton, number);
    const group = new Group();
    group.name = bone.name;
    group.matrixAutoUpdate = false;
    if (isMoving || withScenery) {
      for (const shape of bone.shapes) {
        if (!isMoving && isGround(shape)) {
          continue;
        }
        const material = materials.of(shapeColour(shape), shape.colour[3], isMoving);
        const mesh = shapeMesh(shape, material);
        const isPaint = bone.parent < 0 && !isMoving && goal !== null && isAt(shape, goal);
        (isPaint ? goalPaint : group).add(mesh);
      }
    }
    (isMoving ? object : scenery).add(group);
    return group;
  });
  const matrix = new Matrix4();
  return {
    object,
    scenery: scenery.children.some((group) => group.children.length > 0) ? scenery : null,
    goalPaint: goalPaint.children.length > 0 ? goalPaint : null,
    doubt,
    update(pose) {
      bones.forEach((group, number) => {
        group.matrix.copy(boneMatrix(pose, number, matrix));
        group.matrixWorldNeedsUpdate = true;
      });
    },
    dispose() {
      for (const group of [...bones, goalPaint]) {
        group.children.forEach((child) => (child as Mesh).geometry.dispose());
      }
      materials.dispose();
    },
  };
}

/** Whether a shape is ground, a thin wide box at height 0, which the scenery draws better. */
function isGround(shape: Shape): boolean {
  const [a, b, c] = shape.size;
  const isWide = shape.kind === "box" && Math.min(a!, b!) >= GROUND && c! < 0.1;
  return isWide && Math.abs(shape.position[2] + c!) < 0.05;
}

/** The place of a system's goal, if it has only one [m]. */
function onlyPlace(facts: Bundle): Vector3Facts | null {
  const places = facts.goals.filter((goal) => goal.kind === "state" && goal.movable !== null);
  return places.length === 1 ? places[0]!.movable!.at : null;
}

/** Whether a shape of the world lies under a place. */
function isAt(shape: Shape, place: Vector3Facts): boolean {
  return [0, 1].every((axis) => Math.abs(shape.position[axis]! - place[axis]!) < SAME_PLACE);
}

type Maker = (colour: ReturnType<typeof shapeColour>, opacity: number, isMoving: boolean) => Material;

/** Materials by colour, shared by shapes of the same colour. */
class MaterialKeeper {
  readonly #materials = new Map<string, Material>();

  constructor(private readonly make: Maker) {}

  of(colour: ReturnType<typeof shapeColour>, opacity: number, isMoving: boolean): Material {
    const key = `${colour.getHexString()} ${opacity} ${isMoving}`;
    let material = this.#materials.get(key);
    if (!material) {
      material = this.make(colour, opacity, isMoving);
      this.#materials.set(key, material);
    }
    return material;
  }

  dispose(): void {
    this.#materials.forEach((material) => material.dispose());
  }
}
