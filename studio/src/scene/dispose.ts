// Freeing what three.js keeps on the graphics card.

import { Mesh, type BufferGeometry, type Object3D } from "three";

/** Free the geometry and the materials of a mesh; for `object.traverse(disposeOf)`. */
export function disposeOf(object: Object3D): void {
  if (object instanceof Mesh) {
    (object.geometry as BufferGeometry).dispose();
    const materials = Array.isArray(object.material) ? object.material : [object.material];
    materials.forEach((material: { dispose(): void }) => material.dispose());
  }
}
