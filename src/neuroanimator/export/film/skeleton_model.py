"""Bones and skins as parts of a MuJoCo model that only shows them: bodies moved from outside."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import UInt8

from neuroanimator.appearance.skeleton import Bone, Skeleton
from neuroanimator.appearance.skin import Skin
from neuroanimator.appearance.skin_mesh import SkinMesh, colours_of

PALETTE_WIDTH = 256
"""Width of the texture of a skin's colours [texels]."""

PALETTE_HEIGHT = 4
"""Height of the texture of a skin's colours [texels]: its rows are alike."""

PALETTE_MARGIN = 16
"""What is left free at both ends of that texture [texels], which blend into each other."""

SPECULAR = 0.35
"""How much light a skin mirrors: it is wet."""

SHININESS = 0.4
"""How sharply a skin mirrors light."""


def add_bone(spec: mujoco.MjSpec, name: str, bone: Bone) -> None:
    """Add a bone's shapes to the scene as a body that is moved from outside."""
    body = spec.worldbody.add_body(name=name, mocap=True, pos=bone.offset, quat=bone.orientation)
    for shape in bone.shapes:
        geom_type = getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}")
        size = [*shape.size, 0.0, 0.0][:3]
        body.add_geom(
            type=geom_type,
            size=size,
            pos=shape.position,
            quat=shape.orientation,
            rgba=shape.colour,
            contype=0,
            conaffinity=0,
        )


def add_skin(
    spec: mujoco.MjSpec,
    prefix: str,
    skeleton: Skeleton,
    mesh: SkinMesh,
    colour: tuple[float, float, float, float] | None = None,
) -> mujoco.MjsSkin:
    """Add and return a skin that follows the bones called `prefix` and their number.

    Its colours are a texture, or all one `colour`.
    """
    assert skeleton.skin is not None
    name = f"{prefix}skin"
    material = spec.add_material(name=name, specular=SPECULAR, shininess=SHININESS)
    if colour is None:
        spec.add_texture(
            name=name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=PALETTE_WIDTH,
            height=PALETTE_HEIGHT,
            nchannel=3,
            data=_palette(skeleton.skin).ravel().tolist(),
        )
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    else:
        material.rgba = colour
    coloured = PALETTE_WIDTH - 1 - 2 * PALETTE_MARGIN
    across = (PALETTE_MARGIN + mesh.shades * coloured + 0.5) / PALETTE_WIDTH
    texture_points = np.stack([across, np.full_like(across, 0.5)], axis=1)
    skin = spec.add_skin(name=name, material=name)
    skin.vert = mesh.points.ravel().tolist()
    skin.face = mesh.triangles.ravel().tolist()
    skin.texcoord = texture_points.ravel().tolist()
    skin.bodyname = [f"{prefix}bone{number}" for number in range(len(skeleton.bones))]
    skin.bindpos = np.ravel([bone.offset for bone in skeleton.bones]).tolist()
    skin.bindquat = np.ravel([bone.orientation for bone in skeleton.bones]).tolist()
    points_of_bones = []
    weights_of_bones = []
    for number in range(len(skeleton.bones)):
        weights = np.where(mesh.bones == number, mesh.weights, 0.0).sum(axis=1)
        points_of_bones.append(np.flatnonzero(weights > 0).tolist())
        weights_of_bones.append(weights[weights > 0].tolist())
    skin.vertid = points_of_bones
    skin.vertweight = weights_of_bones
    return skin


def _palette(skin: Skin) -> UInt8[np.ndarray, "H W 3"]:
    """Return the texture of a skin's colours, from shade 0 on its left to shade 1."""
    texels = np.arange(PALETTE_WIDTH)
    shades = (texels - PALETTE_MARGIN) / (PALETTE_WIDTH - 1 - 2 * PALETTE_MARGIN)
    row = colours_of(skin, np.clip(shades, 0, 1))
    return np.round(255 * np.repeat(row[None], PALETTE_HEIGHT, axis=0)).astype(np.uint8)
