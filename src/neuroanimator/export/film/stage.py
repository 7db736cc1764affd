"""A place to film deformable bodies in: sea or floor, light, and the skins on their bones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.skeleton import Bone, Skeleton
from neuroanimator.appearance.skin_mesh import SkinMesh, colours_of, skin_mesh
from neuroanimator.export.film.camera import FIELD, Shots, room_of, shots_of
from neuroanimator.export.film.options import Film

DEPTH = 0.45
"""Of the seabed under the deepest point of the motion, over the body's size."""
PALETTE, MARGIN = 256, 16
"""Width of the texture of colours [texels], and what is left free at both ends, which blend into each other."""
LIGHT = 4.0
"""Distance of the light, over the body's size: near enough for sharp shadows, it goes along."""
SHADOWED = 1.6
"""Half the width of where shadows fall, over the body's size: the less, the finer they are."""
FAR = 60.0
"""Half the width of floor and water, over the body's size."""
MAX_BODIES = 64
"""Filmed at once: MuJoCo's scene has room for so many, bone by bone."""


class Setting(NamedTuple):
    """Where a motion takes place."""

    surface: float | None
    """Height of the water's surface [m]; None if there is none to be seen."""
    ground: bool
    """Whether there is ground at height 0, and air around."""


class Look(NamedTuple):
    """The colours of a place, each 'red green blue', and how far one sees, over the body's size."""

    above: str
    below: str
    fog: str
    floor: str
    ambient: str
    near: float
    far: float


UNDER_WATER = Look(
    "0.45 0.74 0.86",
    "0.04 0.20 0.32",
    "0.12 0.38 0.52",
    "0.66 0.65 0.54",
    "0.42 0.46 0.5",
    3.0,
    16.0,
)
OVER_WATER = Look(
    "0.5 0.68 0.86",
    "0.86 0.91 0.95",
    "0.62 0.77 0.86",
    "0.12 0.34 0.46",
    "0.42 0.44 0.46",
    6.0,
    45.0,
)
ON_GROUND = Look(
    "0.5 0.68 0.86",
    "0.86 0.91 0.95",
    "0.86 0.91 0.95",
    "0.75 0.75 0.76",
    "0.42 0.44 0.46",
    6.0,
    45.0,
)
"""A dive, a look at the sea, a hall."""


class Stage:
    """A MuJoCo model that shows motions of bones, image by image."""

    def __init__(self, clips: Sequence[Clip], film: Film, setting: Setting):
        poses = [_held_poses(clip, max(len(clip.times) for clip in clips)) for clip in clips]
        self.positions = np.concatenate([positions for positions, _ in poses], axis=1)
        self.orientations = np.concatenate([orientations for _, orientations in poses], axis=1)
        self.shots = shots_of(clips, film, setting.surface)
        self._has_surface = setting.surface is not None
        size = self.shots.size
        lowest = 0.0 if setting.ground else float(room_of(clips).low[:, 2].min()) - DEPTH * size
        spec = mujoco.MjSpec.from_string(_scene(self.shots, lowest, setting))
        for number, clip in enumerate(clips):
            _add_body(spec, f"{number} ", clip.skeleton)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def pose(self, frame: int) -> None:
        """Put the bones, and the light, where they are in `frame`."""
        self.data.mocap_pos[:] = self.positions[frame]
        self.data.mocap_quat[:] = self.orientations[frame]
        self.model.light_pos[0] = (
            self.shots.lookat[frame] - self.model.light_dir[0] * LIGHT * self.shots.size
        )
        mujoco.mj_forward(self.model, self.data)

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Let what is far away fade into water or air."""
        scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Take floor and water out of what casts shadows: the sea's surface would darken a polygon of its bed."""
        for number in range(scene.ngeom):
            geom = scene.geoms[number]
            if geom.category == mujoco.mjtCatBit.mjCAT_STATIC:
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR


def _held_poses(clip: Clip, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the bones' places and quaternions in the world in all `frames`; a shorter clip stays at its last."""
    last = np.minimum(np.arange(frames), len(clip.times) - 1)
    positions, orientations = clip.skeleton.world_poses(clip.states)
    return positions[last], orientations[last]


def _scene(shots: Shots, lowest: float, setting: Setting) -> str:
    """Return the place without the bodies, as MJCF."""
    size = shots.size
    if setting.ground:
        look = ON_GROUND
    elif setting.surface is None or shots.is_under_water:
        look = UNDER_WATER
    else:
        look = OVER_WATER
    water = ""
    if setting.surface is not None:
        thin, wide = 0.002 * size, FAR * size
        water = f"""<geom type="box" pos="0 0 {setting.surface - thin:.6g}" size="{wide:.6g} {wide:.6g} {thin:.6g}"
            material="water" contype="0" conaffinity="0"/>"""
    return f"""<mujoco>
      <statistic extent="{size:.6g}" center="0 0 0"/>
      <visual>
        <global fovy="{FIELD}"/>
        <map znear="0.02" zfar="150" fogstart="{look.near}" fogend="{look.far}" shadowclip="{SHADOWED}"/>
        <headlight ambient="{look.ambient}" diffuse="0.25 0.25 0.25" specular="0 0 0"/>
        <rgba fog="{look.fog} 1" haze="{look.fog} 1"/>
      </visual>
      <asset>
        <texture type="skybox" builtin="gradient" rgb1="{look.above}" rgb2="{look.below}" width="256" height="1536"/>
        <texture name="floor" type="2d" builtin="{"checker" if setting.ground else "flat"}" mark="random" random="0.015"
          rgb1="{look.floor}" rgb2="0.68 0.69 0.71" markrgb="0.36 0.38 0.34" width="512" height="512"/>
        <material name="floor" texture="floor" texuniform="true" texrepeat="{1 / size:.6g} {1 / size:.6g}"
          specular="0" shininess="0"/>
        <texture name="water" type="2d" builtin="flat" mark="random" random="0.012" rgb1="0.5 0.75 0.85"
          rgb2="0.5 0.75 0.85" markrgb="1 1 1" width="512" height="512"/>
        <material name="water" texture="water" texuniform="true" texrepeat="{0.9 / size:.6g} {0.9 / size:.6g}"
          rgba="0.55 0.75 0.85 0.25" specular="0.5" shininess="0.8"/>
      </asset>
      <worldbody>
        <light type="directional" dir="-0.12 0.22 -1" pos="0 0 {10 * size:.6g}" diffuse="0.45 0.45 0.42"
          specular="0.2 0.2 0.2" castshadow="true"/>
        <geom type="plane" pos="0 0 {lowest:.6g}" size="{FAR * size:.6g} {FAR * size:.6g} 1" material="floor"
          contype="0" conaffinity="0"/>
        {water}
      </worldbody>
    </mujoco>"""


def _add_body(spec: mujoco.MjSpec, prefix: str, skeleton: Skeleton) -> None:
    """Add a skeleton's bones and skin, their names after `prefix`."""
    for i, bone in enumerate(skeleton.bones):
        add_bone(spec, f"{prefix}bone{i}", bone)
    if skeleton.skin is not None:
        add_skin(spec, prefix, skeleton, skin_mesh(skeleton))


def add_bone(spec: mujoco.MjSpec, name: str, bone: Bone) -> None:
    """Add a bone's shapes to the scene as a body that is moved from outside."""
    body = spec.worldbody.add_body(name=name, mocap=True, pos=bone.offset, quat=bone.orientation)
    for shape in bone.shapes:
        kind = getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}")
        size = [*shape.size, 0.0, 0.0][:3]
        body.add_geom(
            type=kind,
            size=size,
            pos=shape.position,
            quat=shape.orientation,
            rgba=shape.colour,
            contype=0,
            conaffinity=0,
        )


def add_skin(spec: mujoco.MjSpec, prefix: str, skeleton: Skeleton, mesh: SkinMesh) -> None:
    """Add a skin that follows the bones called `prefix` and their number; its colours are a texture."""
    assert skeleton.skin is not None
    at = np.clip((np.arange(PALETTE) - MARGIN) / (PALETTE - 1 - 2 * MARGIN), 0, 1)
    texels = np.round(255 * np.repeat(colours_of(skeleton.skin, at)[None], 4, axis=0)).astype(
        np.uint8
    )
    spec.add_texture(
        name=f"{prefix}skin",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=PALETTE,
        height=4,
        nchannel=3,
        data=texels.ravel().tolist(),
    )
    material = spec.add_material(name=f"{prefix}skin", specular=0.35, shininess=0.4)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = f"{prefix}skin"
    across = (MARGIN + mesh.shades * (PALETTE - 1 - 2 * MARGIN) + 0.5) / PALETTE
    skin = spec.add_skin(name=f"{prefix}skin", material=f"{prefix}skin")
    skin.vert = mesh.points.ravel().tolist()
    skin.face = mesh.triangles.ravel().tolist()
    skin.texcoord = np.stack([across, np.full_like(across, 0.5)], axis=1).ravel().tolist()
    skin.bodyname = [f"{prefix}bone{i}" for i in range(len(skeleton.bones))]
    skin.bindpos = [number for bone in skeleton.bones for number in bone.offset]
    skin.bindquat = [number for bone in skeleton.bones for number in bone.orientation]
    shares = [
        np.where(mesh.bones == i, mesh.weights, 0.0).sum(axis=1) for i in range(len(skeleton.bones))
    ]
    skin.vertid = [np.flatnonzero(share > 0).tolist() for share in shares]
    skin.vertweight = [share[share > 0].tolist() for share in shares]
