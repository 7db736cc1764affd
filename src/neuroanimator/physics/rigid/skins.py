"""The skins of a MuJoCo model for a skeleton."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float, Int

from neuroanimator.appearance.mesh_skin import (
    INFLUENCES,
    MAX_BONES,
    MAX_PARTS,
    MAX_TRIANGLES,
    MAX_VERTICES,
    BoundBone,
    MeshSkin,
    SkinArrays,
    SkinPart,
)
from neuroanimator.appearance.part_names import unique
from neuroanimator.files.names import model_name
from neuroanimator.physics.rigid.rows import rows_at
from neuroanimator.physics.rigid.visuals import colour_of, is_shown

SAME_POSE = 1e-5
"""Difference below which two poses are the same [m, components of a quaternion]."""


def skin_of(model: mujoco.MjModel, first: int) -> MeshSkin | None:
    """Return the skins of `model` that a viewer would draw, as one, each a part of one colour; None if there are none.

    `first` is the body that is bone 0. None, too, for skins too large for a file, and for those that bind one body in two
    poses. A vertex follows the four bodies of the largest weights.
    """
    drawn = []
    for number in range(model.nskin):
        if is_shown(int(model.skin_group[number]), model.skin_rgba[number]):
            drawn.append(number)
    vertices = model.skin_vertnum[drawn].sum()
    triangles = model.skin_facenum[drawn].sum()
    if not drawn or vertices > MAX_VERTICES or triangles > MAX_TRIANGLES or len(drawn) > MAX_PARTS:
        return None
    bones: dict[int, BoundBone] = {}
    arrays = []
    parts = []
    count = 0
    for number in drawn:
        for bone in _bones(model, number, first):
            if bones.setdefault(bone.number, bone) != bone and not _is_same(
                bones[bone.number], bone
            ):
                return None
        own = _arrays(model, number, first)
        if not len(own.triangles):
            continue
        parts.append(_part(model, number, [part.name for part in parts]))
        arrays.append(own._replace(triangles=own.triangles + count))
        count += len(own.vertices)
    if not arrays or len(bones) > MAX_BONES:
        return None
    together = SkinArrays(*(np.concatenate(columns) for columns in zip(*arrays, strict=True)))
    return MeshSkin.of(together, [bones[number] for number in sorted(bones)], parts)


def _part(model: mujoco.MjModel, number: int, taken: list[str]) -> SkinPart:
    """Return the name, not among `taken`, and the colour of a skin."""
    colour = colour_of(model, int(model.skin_matid[number]), model.skin_rgba[number])
    red, green, blue = (round(float(channel), 6) for channel in colour[:3])
    return SkinPart(
        name=unique(model_name(model.skin(number).name, f"skin_{number}"), taken, "_"),
        colour=(red, green, blue),
        triangles=int(model.skin_facenum[number]),
    )


def _bone_range(model: mujoco.MjModel, number: int) -> range:
    """Return the numbers of a skin's bones among those of all skins."""
    return range(model.nskinbone)[rows_at(model.skin_boneadr[number], model.skin_bonenum[number])]


def _bones(model: mujoco.MjModel, number: int, first: int) -> list[BoundBone]:
    return [
        BoundBone(
            number=int(model.skin_bonebodyid[bone]) - first,
            position=tuple(model.skin_bonebindpos[bone].tolist()),
            orientation=tuple(model.skin_bonebindquat[bone].tolist()),
        )
        for bone in _bone_range(model, number)
    ]


def _is_same(one: BoundBone, other: BoundBone) -> bool:
    pose = np.array([*one.position, *one.orientation])
    return bool(np.allclose(pose, [*other.position, *other.orientation], rtol=0, atol=SAME_POSE))


def _arrays(model: mujoco.MjModel, number: int, first: int) -> SkinArrays:
    """Return one skin's arrays, without vertices that are not drawn."""
    rows = rows_at(model.skin_vertadr[number], model.skin_vertnum[number])
    vertices = model.skin_vert[rows].astype(float)
    faces = model.skin_face[rows_at(model.skin_faceadr[number], model.skin_facenum[number])]
    used, triangles = np.unique(faces, return_inverse=True)
    shares = np.zeros((len(vertices), int(model.skin_bonenum[number])))
    bodies = []
    for column, bone in enumerate(_bone_range(model, number)):
        rows = rows_at(model.skin_bonevertadr[bone], model.skin_bonevertnum[bone])
        shares[model.skin_bonevertid[rows], column] += model.skin_bonevertweight[rows]
        bodies.append(int(model.skin_bonebodyid[bone]) - first)
    bones, weights = _most(shares[used], np.array(bodies))
    return SkinArrays(vertices[used], triangles.reshape(faces.shape), bones, weights)


def _most(
    shares: Float[np.ndarray, "V B"], bodies: Int[np.ndarray, " B"]
) -> tuple[Int[np.ndarray, "V 4"], Float[np.ndarray, "V 4"]]:
    """Return the four bones of the largest `shares`, and their weights, which add up to 1."""
    missing = max(INFLUENCES - shares.shape[1], 0)
    shares = np.pad(shares, ((0, 0), (0, missing)))
    bodies = np.pad(bodies, (0, missing), mode="edge")
    order = np.argsort(-shares, axis=1, kind="stable")[:, :INFLUENCES]
    weights = np.take_along_axis(shares, order, axis=1)
    return bodies[order], weights / weights.sum(axis=1, keepdims=True)
