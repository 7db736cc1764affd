// The stand of a body that a hinge fixes to the world, as in a laboratory.

import { CylinderGeometry, Group, Mesh, MeshStandardMaterial, Quaternion, Vector3, type Object3D } from "three";
import type { Bundle } from "../../bundle/bundle";

/** Thickness of the post, length of the axle, and distance of the post behind the body, over the body's size. */
const POST = 0.018;
const AXLE = 0.02;
const BEHIND = 0.09;

export interface Mount {
  readonly object: Object3D;
  /** Position of the hinge [m]. */
  readonly pivot: [number, number, number];
}

/** Return a stand for the first hinge on the world, in physics' axes; null for a free body. */
export function makeMount(facts: Bundle, ground: number, size: number): Mount | null {
  const bone = facts.skeleton.find((one) => one.parent < 0 && one.joints[0]?.kind === "hinge");
  const isBare = facts.skeleton.every((one) => one.parent >= 0 || one.joints.length > 0 || one.shapes.length === 0);
  if (!bone || !isBare) {
    return null;
  }
  const joint = bone.joints[0]!;
  const pivot = new Vector3(...bone.offset).add(new Vector3(...joint.anchor));
  const axis = new Vector3(...joint.axis);
  const foot = pivot.clone().addScaledVector(axis, BEHIND * size);
  const material = new MeshStandardMaterial({ color: 0x9aa3ab, roughness: 0.35, metalness: 0.7 });
  const group = new Group();
  group.name = "mount";
  const add = (geometry: CylinderGeometry, place: Vector3, along: Vector3): void => {
    const mesh = new Mesh(geometry, material);
    mesh.position.copy(place);
    mesh.quaternion.copy(new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), along));
    mesh.castShadow = true;
    mesh.receiveShadow = true;
    group.add(mesh);
  };
  const up = new Vector3(0, 0, 1);
  const height = Math.max(pivot.z - ground, 0.1 * size);
  const axleMiddle = pivot.clone().addScaledVector(axis, (BEHIND / 2) * size);
  add(new CylinderGeometry(AXLE * size * 0.6, AXLE * size * 0.6, BEHIND * size * 1.25, 24), axleMiddle, axis);
  add(new CylinderGeometry(POST * size * 0.7, POST * size, height, 24), foot.clone().addScaledVector(up, -height / 2), up);
  const plate = foot.clone();
  plate.z = ground + 0.008 * size;
  add(new CylinderGeometry(0.13 * size, 0.14 * size, 0.016 * size, 48), plate, up);
  add(new CylinderGeometry(1.9 * POST * size, 1.9 * POST * size, 0.05 * size, 32), foot, axis);
  return { object: group, pivot: [pivot.x, pivot.y, pivot.z] };
}
