// Food for small fish: morsels that sink.

import { Color, InstancedMesh, Matrix4, MeshStandardMaterial, SphereGeometry, type Object3D } from "three";
import { SMALL, type Life } from "../steering/life";

/** Maximum number of morsels drawn. */
const MOST = 400;

/** Radius of a morsel, over the length of a small fish. */
const RADIUS = 0.035;

const COLOUR = new Color(0.95, 0.55, 0.16);

export interface FoodView {
  readonly object: Object3D;
  /** Draw the morsels. */
  update(): void;
  dispose(): void;
}

/** Return the food of fish around a body of `size` [m]. */
export function makeFoodView(life: Life, size: number): FoodView {
  const geometry = new SphereGeometry(RADIUS * SMALL * size, 10, 8);
  const material = new MeshStandardMaterial({ color: COLOUR, emissive: COLOUR, emissiveIntensity: 0.25, roughness: 0.6 });
  const mesh = new InstancedMesh(geometry, material, MOST);
  mesh.name = "food";
  mesh.frustumCulled = false;
  const matrix = new Matrix4();
  const update = (): void => {
    mesh.count = Math.min(life.food.length, MOST);
    life.food.slice(0, MOST).forEach(({ place }, i) => {
      const [x, y, z] = place;
      mesh.setMatrixAt(i, matrix.makeTranslation(x * SMALL, y * SMALL, z * SMALL));
    });
    mesh.instanceMatrix.needsUpdate = true;
  };
  update();
  return {
    object: mesh,
    update,
    dispose() {
      mesh.dispose();
      geometry.dispose();
      material.dispose();
    },
  };
}
