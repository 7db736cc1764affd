// Surfaces of soft bodies: any number of the same kind in one draw call, whose nodes the vertex shader composes of the
// shapes. The processor passes a body's pose and amplitudes, and never touches a node.

import {
  BufferAttribute,
  BufferGeometry,
  DataTexture,
  FloatType,
  Group,
  InstancedMesh,
  Matrix4,
  MeshDepthMaterial,
  NearestFilter,
  RGBAFormat,
  RGBAIntegerFormat,
  ShortType,
  Vector3,
  type Material,
  type Object3D,
} from "three";
import { endsOf, type Collider } from "../../body/colliders";
import { packedOf, ROWS, writeWeights, type PackedSurface } from "../../body/packing";
import type { Pose } from "../../body/pose";
import { rotate } from "../../body/quaternion";
import { surfaceFrame, type Surface } from "../../body/surface";
import { meanNormals } from "../../body/tangents";
import { toQuaternion } from "../axes";
import { patchMaterial, type Patch } from "../glsl";
import { fittingsGeometry } from "./fittings";
import { linear } from "./skin";

/** Offset of a cloth's shadow caster, so that it casts none on itself: over its slope, and in the depth map's units. */
const SHADOW_SLOPE = 8;
const SHADOW_UNITS = 5000;

/** Distance of nodes from colliders, over the size: between nodes a cloth is straight. */
const GAP = 0.006;

export interface ClothView {
  readonly object: Object3D;
  /** The surfaces alone. */
  readonly surfaces: InstancedMesh;
  /** Show cloth `number` in `state` (S) among bones in a pose, displaced by `moved` [m]. */
  show(number: number, state: ArrayLike<number>, pose: Pose, moved?: ArrayLike<number>): void;
  dispose(): void;
}

/** Materials of a cloth and of its fittings, which are invisible if null. */
export interface ClothMaterials {
  /** Return the material of the surface, with the patch that composes its nodes. */
  surface(nodes: Patch): Material;
  readonly fittings: Material | null;
}

/** A kind of cloth. */
export interface ClothKind {
  readonly surface: Surface;
  /** Size [m]. */
  readonly size: number;
  /** Colliders that no node may be in: small errors of an emulator would show as a foot through a cape. */
  readonly colliders: readonly Collider[];
}

/** Return `count` copies of a cloth. */
export function makeCloth({ surface, size, colliders }: ClothKind, count: number, materials: ClothMaterials): ClothView {
  const packed = packedOf(surface);
  const shapes = shapeTexture(packed);
  const weights = weightTexture(packed.groups + 2 * colliders.length, count);
  const numbers = weights.image.data as unknown as Float32Array;
  const nodes = nodesPatch(packed, shapes, weights, colliders.length);
  const geometry = clothGeometry(surface, packed);
  const made = materials.surface(nodes);
  const mesh = new InstancedMesh(geometry, made, count);
  const shadow = new MeshDepthMaterial({ polygonOffset: true, polygonOffsetFactor: SHADOW_SLOPE, polygonOffsetUnits: SHADOW_UNITS });
  const depth = patchMaterial(shadow, [withoutNormals(nodes)]);
  mesh.customDepthMaterial = depth;
  mesh.name = "cloth";
  mesh.frustumCulled = false;
  mesh.castShadow = true;
  mesh.receiveShadow = true;
  // Nodes cannot be grabbed; three.js would look for them at their mean positions.
  mesh.raycast = () => undefined;
  const object = new Group();
  object.add(mesh);
  const fittings = materials.fittings && makeFittings(surface, size, count, materials.fittings);
  if (fittings) {
    object.add(fittings);
  }
  const matrix = new Matrix4();
  const position = new Vector3();
  const unitScale = new Vector3(1, 1, 1);
  return {
    object,
    surfaces: mesh,
    show(number, state, pose, moved = [0, 0, 0]) {
      const { origin, turn } = surfaceFrame(surface, state);
      const back = [turn[0]!, -turn[1]!, -turn[2]!, -turn[3]!];
      position.set(origin[0] + moved[0]!, origin[1] + moved[1]!, origin[2] + moved[2]!);
      matrix.compose(position, toQuaternion(turn), unitScale);
      for (const one of fittings ? [mesh, fittings] : [mesh]) {
        one.setMatrixAt(number, matrix);
        one.instanceMatrix.needsUpdate = true;
      }
      const row = 4 * (packed.groups + 2 * colliders.length) * number;
      writeWeights(surface, state, numbers, row, packed.groups);
      colliders.forEach((collider, i) => {
        const [start, end] = endsOf(collider, pose).map((point) => rotate(back, point.map((value, axis) => value - origin[axis]!)));
        const place = row + 4 * (packed.groups + 2 * i);
        for (let axis = 0; axis < 3; axis++) {
          numbers[place + axis] = start![axis]!;
          numbers[place + 4 + axis] = end![axis]! - start![axis]!;
        }
        numbers[place + 3] = collider.radius + GAP * size;
      });
      weights.needsUpdate = true;
    },
    dispose() {
      mesh.dispose();
      fittings?.geometry.dispose();
      fittings?.dispose();
      materials.fittings?.dispose();
      geometry.dispose();
      made.dispose();
      depth.dispose();
      shapes.dispose();
      weights.dispose();
    },
  };
}

function makeFittings(surface: Surface, size: number, count: number, material: Material): InstancedMesh | null {
  const geometry = fittingsGeometry(surface, size);
  if (!geometry) {
    return null;
  }
  const mesh = new InstancedMesh(geometry, material, count);
  mesh.frustumCulled = false;
  mesh.castShadow = true;
  mesh.receiveShadow = true;
  return mesh;
}

/** The mean surface, with the attributes for its paint and normals. */
function clothGeometry(surface: Surface, packed: PackedSurface): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(surface.mean, 3));
  geometry.setAttribute("normal", new BufferAttribute(meanNormals(surface), 3));
  if (surface.colours) {
    geometry.setAttribute("color", new BufferAttribute(linear(surface.colours.slice()), 3));
    geometry.setAttribute("rest", new BufferAttribute(surface.mean, 3));
  }
  geometry.setAttribute("meanAcross", new BufferAttribute(packed.across, 3));
  geometry.setAttribute("meanAlong", new BufferAttribute(packed.along, 3));
  geometry.setIndex(new BufferAttribute(surface.faces, 1));
  return geometry;
}

function shapeTexture({ texels, width, height }: PackedSurface): DataTexture {
  const texture = new DataTexture(texels, width, height, RGBAIntegerFormat, ShortType);
  texture.internalFormat = "RGBA16I";
  texture.minFilter = NearestFilter;
  texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

/** One row per cloth: weights, then for each collider its start and radius, and the vector to its end. */
function weightTexture(width: number, count: number): DataTexture {
  const texture = new DataTexture(new Float32Array(4 * width * count), width, count, RGBAFormat, FloatType);
  texture.minFilter = NearestFilter;
  texture.magFilter = NearestFilter;
  return texture;
}

/** Composes the nodes of a surface, and their normals, of its shapes (for the layout see body/packing.ts). */
function nodesPatch(packed: PackedSurface, shapes: DataTexture, weights: DataTexture, colliders: number): Patch {
  const { groups, nodesPerRow, tangentScale } = packed;
  return {
    key: `nodes ${groups} ${nodesPerRow} ${colliders}`,
    uniforms: { nodeShapes: { value: shapes }, nodeWeights: { value: weights }, tangentScale: { value: tangentScale } },
    shared: "varying vec3 vMean; varying vec3 vMeanNormal;",
    attributes: `
      attribute vec3 meanAcross;
      attribute vec3 meanAlong;
      uniform highp isampler2D nodeShapes;
      uniform highp sampler2D nodeWeights;
      uniform float tangentScale;
      vec4 nodeWeight(int number) {
        return texelFetch(nodeWeights, ivec2(number, gl_InstanceID), 0);
      }
      ivec2 nodeBlock() {
        return ivec2(gl_VertexID % ${nodesPerRow} * ${ROWS * groups}, gl_VertexID / ${nodesPerRow});
      }
      // The sum of the four shapes of a group from three texels, one per coordinate.
      vec3 nodeSum(ivec2 at, vec4 weight) {
        return vec3(
          dot(vec4(texelFetch(nodeShapes, at, 0)), weight),
          dot(vec4(texelFetch(nodeShapes, at + ivec2(1, 0), 0)), weight),
          dot(vec4(texelFetch(nodeShapes, at + ivec2(2, 0), 0)), weight));
      }
      vec3 nodeMoved() {
        vec3 moved = vec3(0.0);
        ivec2 at = nodeBlock();
        for (int group = 0; group < ${groups}; group++) {
          moved += nodeSum(at, nodeWeight(group));
          at.x += 3;
        }
        return moved;
      }
      vec3 nodeNormal() {
        vec3 across = vec3(0.0);
        vec3 along = vec3(0.0);
        ivec2 at = nodeBlock() + ivec2(${3 * groups}, 0);
        for (int group = 0; group < ${groups}; group++) {
          vec4 weight = nodeWeight(group);
          across += nodeSum(at, weight);
          along += nodeSum(at + ivec2(3, 0), weight);
          at.x += 6;
        }
        return normalize(cross(meanAcross + tangentScale * across, meanAlong + tangentScale * along));
      }
      // Pushes a node out of colliders, and turns its normal toward theirs, more for a deeper node.
      void pushOut(inout vec3 place, inout vec3 normal) {
        for (int number = 0; number < ${colliders}; number++) {
          vec4 start = nodeWeight(${groups} + 2 * number);
          vec3 axis = nodeWeight(${groups} + 2 * number + 1).xyz;
          vec3 away = place - start.xyz;
          away -= axis * clamp(dot(away, axis) / max(dot(axis, axis), 1e-12), 0.0, 1.0);
          float distance = max(length(away), 1e-6);
          float depth = start.w - distance;
          if (depth > 0.0) {
            vec3 outward = away / distance;
            place += depth * outward;
            float facing = dot(normal, outward) < 0.0 ? -1.0 : 1.0;
            normal = normalize(mix(normal, facing * outward, smoothstep(0.0, 0.2 * start.w, depth)));
          }
        }
      }`,
    normal: `
      vec3 nodePlace = position + nodeMoved();
      objectNormal = nodeNormal();
      pushOut(nodePlace, objectNormal);`,
    vertex: `
      vMean = position;
      vMeanNormal = normalize(cross(meanAcross, meanAlong));
      transformed = nodePlace;`,
  };
}

/** The same patch without normals, which shadows do not need. */
function withoutNormals(nodes: Patch): Patch {
  return {
    ...nodes,
    key: `${nodes.key} alone`,
    normal: "",
    vertex: `
      vec3 unseen = vec3(0.0, 0.0, 1.0);
      transformed += nodeMoved();
      pushOut(transformed, unseen);`,
  };
}
