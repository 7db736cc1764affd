"""A place to film a deformable body in: sea or floor, light, a camera that goes along, and the skin on its bones."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from neuroanimator.systems.rotation import heading_of
from neuroanimator.systems.skeleton import Bone, Skeleton
from neuroanimator.systems.skin_mesh import SkinMesh, colours_of, skin_mesh

ELEVATION, ELEVATION_UNDER_WATER, ASIDE = -14.0, -26.0, -22.0
"""[deg] The camera looks down by so much, more where it must show a tail's beat, and from ahead of the body's side."""
DISTANCE, DISTANCE_FROM_WATER, DISTANCE_ON_GROUND = 1.2, 1.4, 2.2
"""Of the camera, over the body's size; leaps and falls need room."""
FOLLOWING = 0.8
"""[s] Over which the camera's way is smoothed."""
LAG = 0.15
"""Farthest the camera may look beside the body, over its size."""
DEPTH = 0.45
"""Of the seabed under the deepest point of the motion, over the body's size."""
PALETTE, MARGIN = 256, 16
"""Width of the texture of colours [texels], and what is left free at both ends, which blend into each other."""
LIGHT = 4.0
"""Distance of the light, over the body's size: near enough for sharp shadows, it goes along."""
FAR = 60.0
"""Half the width of floor and water, over the body's size."""


class Setting(NamedTuple):
    """Where a motion takes place."""

    surface: float | None
    """Height of the water's surface [m]; None if there is none to be seen."""
    ground: bool
    """Whether there is ground at height 0, and air around."""

    @property
    def is_dry(self) -> bool:
        """Whether the camera is in air."""
        return self.ground or self.surface is not None

    @property
    def elevation(self) -> float:
        """Of the camera [deg]."""
        return ELEVATION if self.is_dry else ELEVATION_UNDER_WATER

    @property
    def distance(self) -> float:
        """Of the camera, over the body's size."""
        if self.ground:
            return DISTANCE_ON_GROUND
        return DISTANCE if self.surface is None else DISTANCE_FROM_WATER


class Stage:
    """A MuJoCo model that shows a motion of bones, frame by frame."""

    def __init__(self, skeleton: Skeleton, states: np.ndarray, rate: float, setting: Setting):
        self.places, self.turns = skeleton.world_poses(states)
        mesh = skin_mesh(skeleton) if skeleton.skin is not None else None
        points = np.array([bone.offset for bone in skeleton.bones]) if mesh is None else mesh.points
        self.size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self.setting = setting
        self._centres = camera_way(self.places.mean(axis=1), round(rate * FOLLOWING), LAG * self.size)
        self._heading = float(np.degrees(heading_of(self.turns[0, len(skeleton.bones) // 2])))
        lowest = 0.0 if setting.ground else float(self.places[..., 2].min()) - DEPTH * self.size
        spec = mujoco.MjSpec.from_string(_scene(self.size, lowest, setting))
        for i, bone in enumerate(skeleton.bones):
            _add_bone(spec, f"bone{i}", bone)
        if mesh is not None:
            _add_skin(spec, skeleton, mesh)
        self.model = spec.compile()

    def pose(self, data: mujoco.MjData, frame: int) -> None:
        """Put the bones where they are in `frame`."""
        data.mocap_pos[:], data.mocap_quat[:] = self.places[frame], self.turns[frame]
        self.model.light_pos[0] = self._centres[frame] - self.model.light_dir[0] * LIGHT * self.size

    def camera(self, frame: int) -> mujoco.MjvCamera:
        """Return the camera in `frame`: at the side of the body, a little above."""
        camera = mujoco.MjvCamera()
        camera.lookat[:] = self._centres[frame]
        camera.azimuth, camera.elevation = self._heading + 90 + ASIDE, self.setting.elevation
        camera.distance = self.size * self.setting.distance
        return camera

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Let what is far away fade into water or air."""
        scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0


def camera_way(ways: np.ndarray, frames: int, lag: float) -> np.ndarray:
    """Return ways (F, 3) [m] smoothed over up to `frames`, less if the camera would lag by more than `lag` [m]."""
    while frames > 0:
        smoothed = _smoothed(ways, frames)
        if np.linalg.norm(smoothed - ways, axis=1).max() <= lag:
            return smoothed
        frames //= 2
    return ways


def _smoothed(ways: np.ndarray, frames: int) -> np.ndarray:
    """Return ways (F, 3) averaged twice over `frames`, ends held by straight continuation."""
    for _ in range(2):
        before = 2 * ways[0] - ways[1 : frames + 1][::-1] if len(ways) > frames else np.repeat(ways[:1], frames, axis=0)
        after = 2 * ways[-1] - ways[-frames - 1 : -1][::-1] if len(ways) > frames else np.repeat(ways[-1:], frames, 0)
        total = np.cumsum(np.concatenate([np.zeros((1, 3)), before, ways, after]), axis=0)
        ways = (total[2 * frames + 1 :] - total[: -2 * frames - 1]) / (2 * frames + 1)
    return ways


def _scene(size: float, lowest: float, setting: Setting) -> str:
    """Return the place without the body, as MJCF."""
    dry = setting.is_dry
    sky = ("0.5 0.68 0.86", "0.86 0.91 0.95") if dry else ("0.36 0.66 0.8", "0.05 0.2 0.32")
    fog = "0.86 0.91 0.95" if setting.ground else "0.62 0.77 0.86" if dry else "0.12 0.36 0.5"
    floor = "0.75 0.75 0.76" if setting.ground else "0.12 0.34 0.46" if dry else "0.66 0.65 0.54"
    water = ""
    if setting.surface is not None:
        thin, wide = 0.002 * size, FAR * size
        water = f"""<geom type="box" pos="0 0 {setting.surface - thin:.6g}" size="{wide:.6g} {wide:.6g} {thin:.6g}"
            material="water" contype="0" conaffinity="0"/>"""
    return f"""<mujoco>
      <statistic extent="{size:.6g}" center="0 0 0"/>
      <visual>
        <global fovy="45" offwidth="1920" offheight="1440"/>
        <quality shadowsize="2048" offsamples="4"/>
        <map znear="0.02" zfar="150" fogstart="{4 if dry else 1.6}" fogend="{40 if dry else 9}" shadowclip="1.2"/>
        <headlight ambient="0.5 0.52 0.54" diffuse="0.2 0.2 0.2" specular="0 0 0"/>
        <rgba fog="{fog} 1" haze="{fog} 1"/>
      </visual>
      <asset>
        <texture type="skybox" builtin="gradient" rgb1="{sky[0]}" rgb2="{sky[1]}" width="256" height="1536"/>
        <texture name="floor" type="2d" builtin="{"checker" if setting.ground else "flat"}" mark="random" random="0.015"
          rgb1="{floor}" rgb2="0.68 0.69 0.71" markrgb="0.36 0.38 0.34" width="512" height="512"/>
        <material name="floor" texture="floor" texuniform="true" texrepeat="{1 / size:.6g} {1 / size:.6g}"
          specular="0" shininess="0"/>
        <texture name="water" type="2d" builtin="flat" mark="random" random="0.012" rgb1="0.5 0.75 0.85"
          rgb2="0.5 0.75 0.85" markrgb="1 1 1" width="512" height="512"/>
        <material name="water" texture="water" texuniform="true" texrepeat="{0.9 / size:.6g} {0.9 / size:.6g}"
          rgba="0.55 0.75 0.85 0.25" specular="0.5" shininess="0.8"/>
      </asset>
      <worldbody>
        <light directional="true" dir="-0.12 0.22 -1" pos="0 0 {10 * size:.6g}" diffuse="0.5 0.5 0.47"
          specular="0.25 0.25 0.25" castshadow="true"/>
        <geom type="plane" pos="0 0 {lowest:.6g}" size="{FAR * size:.6g} {FAR * size:.6g} 1" material="floor"
          contype="0" conaffinity="0"/>
        {water}
      </worldbody>
    </mujoco>"""


def _add_bone(spec: mujoco.MjSpec, name: str, bone: Bone) -> None:
    body = spec.worldbody.add_body(name=name, mocap=True, pos=bone.offset, quat=bone.turn)
    for shape in bone.shapes:
        kind = getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}")
        size = [*shape.size, 0.0, 0.0][:3]
        body.add_geom(
            type=kind, size=size, pos=shape.place, quat=shape.turn, rgba=shape.colour, contype=0, conaffinity=0
        )


def _add_skin(spec: mujoco.MjSpec, skeleton: Skeleton, mesh: SkinMesh) -> None:
    assert skeleton.skin is not None
    at = np.clip((np.arange(PALETTE) - MARGIN) / (PALETTE - 1 - 2 * MARGIN), 0, 1)
    texels = np.round(255 * np.repeat(colours_of(skeleton.skin, at)[None], 4, axis=0)).astype(np.uint8)
    spec.add_texture(
        name="skin",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=PALETTE,
        height=4,
        nchannel=3,
        data=texels.ravel().tolist(),
    )
    material = spec.add_material(name="skin", specular=0.35, shininess=0.4)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "skin"
    across = (MARGIN + mesh.shades * (PALETTE - 1 - 2 * MARGIN) + 0.5) / PALETTE
    skin = spec.add_skin(name="skin", material="skin")
    skin.vert = mesh.points.ravel().tolist()
    skin.face = mesh.triangles.ravel().tolist()
    skin.texcoord = np.stack([across, np.full_like(across, 0.5)], axis=1).ravel().tolist()
    skin.bodyname = [f"bone{i}" for i in range(len(skeleton.bones))]
    skin.bindpos = [number for bone in skeleton.bones for number in bone.offset]
    skin.bindquat = [number for bone in skeleton.bones for number in bone.turn]
    shares = [np.where(mesh.bones == i, mesh.weights, 0.0).sum(axis=1) for i in range(len(skeleton.bones))]
    skin.vertid = [np.flatnonzero(share > 0).tolist() for share in shares]
    skin.vertweight = [share[share > 0].tolist() for share in shares]
