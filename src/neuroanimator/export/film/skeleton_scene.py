"""A film's scene of bodies that have no MuJoCo model of their own: their bones and skins in a sea or a hall."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin_mesh import skin_mesh
from neuroanimator.export.film.bounding_boxes import bounding_boxes
from neuroanimator.export.film.camera import FIELD_OF_VIEW, Shots, take_shots
from neuroanimator.export.film.options import Film
from neuroanimator.export.film.skeleton_model import add_bone, add_skin
from neuroanimator.export.film.splashes import Splashes
from neuroanimator.export.film.takes import Take
from neuroanimator.export.film.trust_shown import doubts, glow
from neuroanimator.export.ghost import GHOST_RGBA

SEABED_DEPTH = 0.45
"""How far the seabed lies under the deepest point of the motion, over the body's size."""

LIGHT_DISTANCE = 4.0
"""Distance of the light, over the body's size: near enough for sharp shadows, it goes along."""

SHADOW_REACH = 1.6
"""Half the width of where shadows fall, over the body's size: the less, the finer they are."""

SAME_PLACE = 1e-9
"""Bones whose positions [m] and quaternions differ by less are in the same place."""

HALF_WIDTH = 60.0
"""Half the width of floor and water, over the body's size."""

STONES = 90
"""Stones on the seabed: what a body passes shows how fast it goes."""

STONE_SIZES = (0.02, 0.09)
"""Half the length of the smallest and the largest stone, over the body's size."""

STONE_BAND = 4.0
"""How far from the way of the body stones lie, over its size."""

STONE_COLOURS = ((0.46, 0.45, 0.40), (0.56, 0.54, 0.46), (0.37, 0.39, 0.38))
"""The sRGB colours of stones."""

GHOST_SWELLING = 0.004
"""How much further out a ghost's surface is drawn, over the body's size: it shows no spots where both are the same."""

WATER_THICKNESS = 0.002
"""Half the thickness of the water's surface, over the body's size."""


class Setting(NamedTuple):
    """Where a motion takes place."""

    surface: float | None
    """Height of the water's surface [m]; None if there is none to be seen."""
    has_ground: bool
    """Whether there is ground at height 0, and air around."""


class Colours(NamedTuple):
    """The colours of a place, each 'red green blue', and how far one sees, over the body's size."""

    above: str
    """The sky at the top."""
    below: str
    """The sky at the bottom."""
    fog: str
    """What everything fades into."""
    floor: str
    ambient: str
    """The light from everywhere."""
    near: float
    """From where on things begin to fade."""
    far: float
    """Where all has faded."""


UNDER_WATER = Colours(
    above="0.45 0.74 0.86",
    below="0.04 0.20 0.32",
    fog="0.12 0.38 0.52",
    floor="0.66 0.65 0.54",
    ambient="0.42 0.46 0.5",
    near=3.0,
    far=16.0,
)
"""The colours of a dive."""

OVER_WATER = Colours(
    above="0.5 0.68 0.86",
    below="0.86 0.91 0.95",
    fog="0.62 0.77 0.86",
    floor="0.12 0.34 0.46",
    ambient="0.42 0.44 0.46",
    near=6.0,
    far=45.0,
)
"""The colours of a look at the sea."""

ON_GROUND = Colours(
    above="0.5 0.68 0.86",
    below="0.86 0.91 0.95",
    fog="0.86 0.91 0.95",
    floor="0.75 0.75 0.76",
    ambient="0.42 0.44 0.46",
    near=6.0,
    far=45.0,
)
"""The colours of a hall."""


class SkeletonScene:
    """A MuJoCo model that shows motions of bones in a sea or a hall, image by image."""

    def __init__(self, take: Take, film: Film, setting: Setting):
        poses = [_held_poses(clip, take.frames) for clip in take.everything]
        self.positions = np.concatenate([positions for positions, _ in poses], axis=1)
        self.orientations = np.concatenate([orientations for _, orientations in poses], axis=1)
        self.shots = take_shots(take, film, setting.surface)
        floor = 0.0
        if not setting.has_ground:
            lowest = float(bounding_boxes(take.clips).low[:, 2].min())
            floor = lowest - SEABED_DEPTH * self.shots.size
        spec = mujoco.MjSpec.from_string(_place_mjcf(self.shots, floor, setting))
        for number, clip in enumerate(take.clips):
            _add_skeleton(spec, f"{number} ", clip.skeleton)
        if take.ghost is not None:
            is_elsewhere = ~_are_alike(poses[0], poses[-1])
            swelling = GHOST_SWELLING * self.shots.size
            _add_ghost(spec, "ghost ", take.ghost.skeleton, is_elsewhere, swelling)
        if _colours(self.shots, setting) is UNDER_WATER:
            _add_stones(spec, self.shots, floor)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._doubts = np.stack([doubts(clip, take.frames) for clip in take.clips])
        self._owners = _owners(self.model, len(take.clips))
        self._frame = 0
        self._splashes: Splashes | None = None
        if setting.surface is not None:
            bodies = np.concatenate([each.positions for each in poses[: len(take.clips)]], axis=1)
            rate = take.clips[0].rate
            self._splashes = Splashes(bodies, rate, setting.surface, self.shots.size)

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Let what is far away fade into water or air."""
        scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0

    def pose(self, frame: int) -> None:
        """Put the bones, and the light, where they are in `frame`."""
        self._frame = frame
        self.data.mocap_pos[:] = self.positions[frame]
        self.data.mocap_quat[:] = self.orientations[frame]
        offset = self.model.light_dir[0] * LIGHT_DISTANCE * self.shots.size
        self.model.light_pos[0] = self.shots.lookat[frame] - offset
        mujoco.mj_forward(self.model, self.data)

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Take floor and water out of what casts shadows: the sea's surface would darken a polygon of its bed. Add splashes."""
        for number in range(scene.ngeom):
            geom = scene.geoms[number]
            if geom.category == mujoco.mjtCatBit.mjCAT_STATIC:
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        glow(scene, self._owners, self._doubts[:, self._frame])
        if self._splashes is not None:
            self._splashes.fill(scene, self._frame)


def _owners(model: mujoco.MjModel, clips: int) -> dict[int, Int[np.ndarray, " N"]]:
    """Return, by kind of object and number, of which clip it is: -1 for what is scenery or a ghost's."""
    prefixes = {f"{number} ": number for number in range(clips)}

    def owner(name: str) -> int:
        return next((number for start, number in prefixes.items() if name.startswith(start)), -1)

    bodies = np.array([owner(model.body(number).name) for number in range(model.nbody)])
    skins = np.array([owner(model.skin(number).name) for number in range(model.nskin)], int)
    return {
        int(mujoco.mjtObj.mjOBJ_GEOM): bodies[model.geom_bodyid],
        int(mujoco.mjtObj.mjOBJ_SKIN): skins,
    }


def _add_skeleton(spec: mujoco.MjSpec, prefix: str, skeleton: Skeleton) -> None:
    """Add a skeleton's bones and skin, their names after `prefix`."""
    for number, bone in enumerate(skeleton.bones):
        add_bone(spec, f"{prefix}bone{number}", bone)
    if skeleton.skin is not None:
        add_skin(spec, prefix, skeleton, skin_mesh(skeleton))


def _add_stones(spec: mujoco.MjSpec, shots: Shots, floor: float) -> None:
    """Scatter stones, the same every time, over the seabed at the height `floor` [m] along the body's way."""
    rng = np.random.default_rng(0)
    size = shots.size
    low = shots.lookat[:, :2].min(axis=0) - STONE_BAND * size
    high = shots.lookat[:, :2].max(axis=0) + STONE_BAND * size
    small, large = STONE_SIZES
    for number in range(STONES):
        # Most are small.
        length = size * (small + (large - small) * rng.random() ** 3)
        half_sizes = length * np.array([1.0, rng.uniform(0.6, 0.9), rng.uniform(0.35, 0.6)])
        turn = rng.uniform(0, np.pi)
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            size=half_sizes,
            pos=[*rng.uniform(low, high), floor + 0.3 * half_sizes[2]],
            quat=[np.cos(turn), 0, 0, np.sin(turn)],
            rgba=[*STONE_COLOURS[number % len(STONE_COLOURS)], 1],
            contype=0,
            conaffinity=0,
        )


def _are_alike(one: Poses, other: Poses) -> Bool[np.ndarray, " B"]:
    """Return which bones are in the same place all the time in two motions of a body."""
    apart = np.abs(one.positions - other.positions).max(axis=(0, 2))
    turned = np.abs(one.orientations - other.orientations).max(axis=(0, 2))
    return (apart < SAME_PLACE) & (turned < SAME_PLACE)


def _add_ghost(
    spec: mujoco.MjSpec,
    prefix: str,
    skeleton: Skeleton,
    is_shown: Bool[np.ndarray, " B"],
    swelling: float,
) -> None:
    """Add the bones of a skeleton that are shown, and its skin, in the one colour of ghosts; its names after `prefix`.

    They are larger on all sides by `swelling` [m].
    """
    for number, bone in enumerate(skeleton.bones):
        shapes = bone.shapes if is_shown[number] else ()
        tinted = tuple(
            replace(
                shape,
                colour=GHOST_RGBA,
                size=tuple(length + swelling for length in shape.size),
            )
            for shape in shapes
        )
        add_bone(spec, f"{prefix}bone{number}", replace(bone, shapes=tinted))
    if skeleton.skin is not None:
        skin = add_skin(spec, prefix, skeleton, skin_mesh(skeleton), colour=GHOST_RGBA)
        skin.inflate = swelling


class Poses(NamedTuple):
    """Where the bones of a body are in every image."""

    positions: Float[np.ndarray, "F B 3"]
    """In the world [m]."""
    orientations: Float[np.ndarray, "F B 4"]
    """Their quaternions in the world."""


def _held_poses(clip: Clip, frames: int) -> Poses:
    """Return the bones' positions and quaternions in the world in all `frames`; a shorter clip stays at its last."""
    index = np.minimum(np.arange(frames), len(clip.times) - 1)
    positions, orientations = clip.skeleton.world_poses(clip.states)
    return Poses(positions[index], orientations[index])


def _colours(shots: Shots, setting: Setting) -> Colours:
    if setting.has_ground:
        return ON_GROUND
    if setting.surface is None or shots.is_under_water:
        return UNDER_WATER
    return OVER_WATER


def _place_mjcf(shots: Shots, floor: float, setting: Setting) -> str:
    """Return the place without the bodies, as MJCF; `floor` is the height of floor or seabed [m]."""
    size = shots.size
    colours = _colours(shots, setting)
    floor_texture = "checker" if setting.has_ground else "flat"
    wide = HALF_WIDTH * size
    water = ""
    if setting.surface is not None:
        thin = WATER_THICKNESS * size
        water = f"""<geom type="box" pos="0 0 {setting.surface - thin:.6g}" size="{wide:.6g} {wide:.6g} {thin:.6g}"
            material="water" contype="0" conaffinity="0"/>"""
    return f"""<mujoco>
      <statistic extent="{size:.6g}" center="0 0 0"/>
      <visual>
        <global fovy="{FIELD_OF_VIEW}"/>
        <map znear="0.02" zfar="150" fogstart="{colours.near}" fogend="{colours.far}" shadowclip="{SHADOW_REACH}"/>
        <headlight ambient="{colours.ambient}" diffuse="0.25 0.25 0.25" specular="0 0 0"/>
        <rgba fog="{colours.fog} 1" haze="{colours.fog} 1"/>
      </visual>
      <asset>
        <texture type="skybox" builtin="gradient" rgb1="{colours.above}" rgb2="{colours.below}" width="256" height="1536"/>
        <texture name="floor" type="2d" builtin="{floor_texture}" mark="random" random="0.015"
          rgb1="{colours.floor}" rgb2="0.68 0.69 0.71" markrgb="0.36 0.38 0.34" width="512" height="512"/>
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
        <geom type="plane" pos="0 0 {floor:.6g}" size="{wide:.6g} {wide:.6g} 1" material="floor"
          contype="0" conaffinity="0"/>
        {water}
      </worldbody>
    </mujoco>"""
