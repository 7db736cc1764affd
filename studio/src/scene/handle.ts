// A draggable target in the scene, and the line by which a body is pulled.

import {
  BufferAttribute,
  BufferGeometry,
  Color,
  DoubleSide,
  Group,
  Line,
  LineBasicMaterial,
  Mesh,
  MeshBasicMaterial,
  RingGeometry,
  SphereGeometry,
  type Object3D,
} from "three";

export const TARGET_COLOUR = new Color(0.17, 0.85, 0.8);

export interface TargetHandle {
  readonly object: Object3D;
  /** Its position [m], in physics' axes. */
  readonly place: [number, number, number];
  moveTo(place: ArrayLike<number>): void;
  dispose(): void;
}

/** Return a target for a body of `size` [m]; `reach` is its tolerance [m], if known. */
export function makeTarget(size: number, reach = 0.12 * size): TargetHandle {
  const object = new Group();
  object.name = "target";
  const geometries: BufferGeometry[] = [];
  const materials: MeshBasicMaterial[] = [];
  const add = (geometry: BufferGeometry, opacity: number): Mesh => {
    const material = new MeshBasicMaterial({
      color: TARGET_COLOUR,
      transparent: true,
      opacity,
      side: DoubleSide,
      depthWrite: false,
      toneMapped: false,
    });
    const mesh = new Mesh(geometry, material);
    mesh.renderOrder = 20;
    geometries.push(geometry);
    materials.push(material);
    object.add(mesh);
    return mesh;
  };
  add(new SphereGeometry(0.035 * size, 20, 14), 0.95);
  add(new SphereGeometry(reach, 28, 18), 0.1);
  add(new RingGeometry(0.94 * reach, reach, 64), 0.8);
  add(new RingGeometry(0.94 * reach, reach, 64), 0.8).rotation.x = Math.PI / 2;
  const place: [number, number, number] = [0, 0, 0];
  return {
    object,
    place,
    moveTo(to) {
      for (let axis = 0; axis < 3; axis++) {
        place[axis] = to[axis]!;
      }
      object.position.fromArray(place);
    },
    dispose() {
      geometries.forEach((geometry) => geometry.dispose());
      materials.forEach((material) => material.dispose());
    },
  };
}

export interface Knob {
  readonly object: Object3D;
  /** Put it at a place [m], in physics' axes. */
  moveTo(place: ArrayLike<number>): void;
  dispose(): void;
}

/** Return a knob for a draggable but invisible thing, for a body of `size` [m]. */
export function makeKnob(size: number): Knob {
  const geometry = new SphereGeometry(0.022 * size, 20, 14);
  const material = new MeshBasicMaterial({ color: TARGET_COLOUR, transparent: true, opacity: 0.85, toneMapped: false });
  const object = new Mesh(geometry, material);
  object.name = "knob";
  return {
    object,
    moveTo: (place) => void object.position.set(place[0]!, place[1]!, place[2]!),
    dispose() {
      geometry.dispose();
      material.dispose();
    },
  };
}

export interface PathLine {
  readonly object: Object3D;
  /** Show a line through points [m] (n * 3), in physics' axes. */
  show(points: ArrayLike<number>): void;
  dispose(): void;
}

/** Return a line of at most `most` points: a path of a body, or a pull. */
export function makePathLine(colour: Color, opacity: number, most: number): PathLine {
  const geometry = new BufferGeometry();
  const attribute = new BufferAttribute(new Float32Array(3 * most), 3);
  geometry.setAttribute("position", attribute);
  const material = new LineBasicMaterial({
    color: colour,
    transparent: true,
    opacity,
    depthTest: false,
    toneMapped: false,
  });
  const object = new Line(geometry, material);
  object.frustumCulled = false;
  object.renderOrder = 21;
  return {
    object,
    show(points) {
      const count = Math.min(points.length, 3 * most);
      for (let i = 0; i < count; i++) {
        attribute.array[i] = points[i]!;
      }
      attribute.needsUpdate = true;
      geometry.setDrawRange(0, count / 3);
    },
    dispose() {
      geometry.dispose();
      material.dispose();
    },
  };
}
