"""Bodies without a MuJoCo model: bones, skins and surfaces over a floor or in water."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.part_names import FLOOR, colour_names
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin_mesh import colours_of, skin_mesh
from neuroanimator.export.film.bounding_boxes import bounding_boxes
from neuroanimator.export.film.camera import Shots
from neuroanimator.export.film.options import Take
from neuroanimator.export.film.scene import frame_model, glow
from neuroanimator.export.ghost import GHOST_GROWTH, GHOST_RGBA
from neuroanimator.export.morphs import CLOTH_RGBA, surface_normals
from neuroanimator.systems.system import System

SEABED_DEPTH = 0.45
"""Depth of the seabed under the deepest point of the motion, over the body's size."""

FLOOR_DEPTH = 0.03
"""Depth of the ground under a model's own floor, which would else show through, or under the motion; over the body's size."""

HALF_WIDTH = 60.0
"""Half the width of floor and water, over the body's size."""

WATER_THICKNESS = 0.002
"""Half the thickness of the water's surface, over the body's size."""

PALETTE_WIDTH = 256
"""Width of the texture of a skin's colours [texels]."""

PALETTE_MARGIN = 16
"""Free width at both ends of that texture [texels], which blend into each other."""


class _Place(NamedTuple):
    """The colours of a place, each 'red green blue', and the distances at which it fades, over the body's size."""

    sky: str
    horizon: str
    floor: str
    squares: str
    fading: str


UNDER_WATER = _Place(
    sky="0.45 0.74 0.86",
    horizon="0.12 0.38 0.52",
    floor="0.66 0.65 0.54",
    squares="0.64 0.63 0.525",
    fading='fogstart="3" fogend="16"',
)
OVER_WATER = _Place(
    sky="0.5 0.68 0.86",
    horizon="0.62 0.77 0.86",
    floor="0.12 0.34 0.46",
    squares="0.11 0.32 0.44",
    fading='fogstart="6" fogend="45"',
)
ON_GROUND = _Place(
    sky="0.5 0.68 0.86",
    horizon="0.86 0.91 0.95",
    floor="0.75 0.75 0.76",
    squares="0.71 0.72 0.73",
    fading='fogstart="6" fogend="45"',
)


@final
class SkeletonScene:
    """Bodies, and a ghost, moved from outside."""

    def __init__(self, take: Take, shots: Shots, system: System | None):
        """Put them into water or on ground, whichever their `system` is in; at a height of 0 without its physics."""
        floor = 0.0
        surface = None
        place = ON_GROUND
        depth = FLOOR_DEPTH
        if system is not None and system.structure.is_in_water:
            surface = system.water_surface
            is_below = surface is None or shots.is_under_water
            place = UNDER_WATER if is_below else OVER_WATER
            depth = SEABED_DEPTH
        if system is not None and not system.has_ground:
            floor = float(bounding_boxes(take.clips).low[:, 2].min()) - depth * shots.size
        elif FLOOR in colour_names(take.clips[0].skeleton).values():
            floor = -depth * shots.size
        spec = mujoco.MjSpec.from_string(_place_mjcf(place, shots.size, floor, surface))
        self._skeletons = [clip.skeleton for clip in take.everything]
        for number, skeleton in enumerate(self._skeletons):
            if number < len(take.clips):
                _add_skeleton(spec, f"{number} ", skeleton, has_scenery=number == 0)
            else:
                _add_skeleton(spec, f"{number} ", _as_ghost(skeleton), is_ghost=True)
        self.model = spec.compile()
        self._surfaces: dict[int, _Surface] = {}
        for number, skeleton in enumerate(self._skeletons):
            if skeleton.shapes is not None:
                skin = self.model.skin(f"{number} surface")
                inflation = float(skin.inflate[0])
                self._surfaces[number] = _Surface(skin.id, skeleton.shapes, inflation)
        self.data = mujoco.MjData(self.model)
        self.doubt = 0.0
        frame_model(self.model, shots)

    def pose(self, states: Sequence[Float[np.ndarray, " S"]]) -> None:
        """Set the bones to `states`."""
        positions = []
        orientations = []
        for skeleton, state in zip(self._skeletons, states, strict=True):
            position, orientation = skeleton.world_poses(state[None])
            positions.append(position[0])
            orientations.append(orientation[0])
        self.data.mocap_pos[:] = np.concatenate(positions)
        self.data.mocap_quat[:] = np.concatenate(orientations)
        for number, surface in self._surfaces.items():
            surface.pose(states[number])
        mujoco.mj_forward(self.model, self.data)

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Fade distant things, let bodies in doubt glow, and move the nodes of surfaces."""
        for surface in self._surfaces.values():
            surface.fill(scene)
        scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0
        bodies = []
        for number in range(scene.ngeom):
            geom = scene.geoms[number]
            is_skin = geom.objtype == mujoco.mjtObj.mjOBJ_SKIN
            if not is_skin and self.model.geom_bodyid[geom.objid] == 0:
                # The sea's surface would cast a shadow on its bed.
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR
            elif geom.rgba[3] > GHOST_RGBA[3]:
                bodies.append(geom)
        glow(bodies, self.doubt)


class _Surface:
    """The surface of a soft body: a two-sided skin whose points no bone moves."""

    def __init__(self, number: int, shapes: Shapes, inflation: float):
        """`number` is the skin's in the model, and `inflation` the distance from the nodes to either side [m]."""
        self._number = number
        self._shapes = shapes
        self._inflation = inflation

    def pose(self, state: Float[np.ndarray, " S"]) -> None:
        """Decode the nodes of a state."""
        points = self._shapes.decode(state)
        normals = surface_normals(self._shapes, points)
        self._normals = np.concatenate([normals, -normals])
        self._points = np.concatenate([points, points]) + self._inflation * self._normals

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Move the points in a picture, where MuJoCo has put them at rest."""
        first = 3 * scene.skinvertadr[self._number]
        coordinates = slice(first, first + self._points.size)
        scene.skinvert[coordinates] = self._points.ravel()
        scene.skinnormal[coordinates] = self._normals.ravel()


def _as_ghost(skeleton: Skeleton) -> Skeleton:
    """Return a skeleton in the colour of ghosts, slightly larger."""
    bones = []
    for bone in skeleton.bones:
        tinted = []
        for shape in bone.shapes:
            size = tuple(GHOST_GROWTH * length for length in shape.size)
            tinted.append(replace(shape, colour=GHOST_RGBA, size=size))
        bones.append(replace(bone, shapes=tuple(tinted)))
    return replace(skeleton, bones=tuple(bones))


def _add_skeleton(
    spec: mujoco.MjSpec,
    prefix: str,
    skeleton: Skeleton,
    *,
    has_scenery: bool = False,
    is_ghost: bool = False,
) -> None:
    """Add a skeleton's bones, as bodies moved from outside whose names begin with `prefix`, and its skin.

    Bones that nothing moves are scenery.
    """
    for number, bone in enumerate(skeleton.bones):
        body = spec.worldbody.add_body(
            name=f"{prefix}bone{number}", mocap=True, pos=bone.offset, quat=bone.orientation
        )
        if not (has_scenery or skeleton.is_moved(number)):
            continue
        for shape in bone.shapes:
            body.add_geom(
                type=getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}"),
                size=[*shape.size, 0.0, 0.0][:3],
                pos=shape.position,
                quat=shape.orientation,
                rgba=shape.colour,
                contype=0,
                conaffinity=0,
            )
    if skeleton.skin is not None:
        _add_skin(spec, prefix, skeleton, is_ghost)
    if skeleton.shapes is not None:
        _add_surface(spec, prefix, skeleton.shapes, is_ghost)


def _add_skin(spec: mujoco.MjSpec, prefix: str, skeleton: Skeleton, is_ghost: bool) -> None:
    """Add a skin that follows the bones whose names begin with `prefix`; its colours are a texture."""
    assert skeleton.skin is not None
    mesh = skin_mesh(skeleton)
    name = f"{prefix}skin"
    material = spec.add_material(name=name, specular=0.35, shininess=0.4)
    skin = spec.add_skin(name=name, material=name)
    if is_ghost:
        material.rgba = GHOST_RGBA
        skin.inflate = (GHOST_GROWTH - 1) * float(np.ptp(mesh.points, axis=0).max())
    else:
        coloured = PALETTE_WIDTH - 1 - 2 * PALETTE_MARGIN
        shades = np.clip((np.arange(PALETTE_WIDTH) - PALETTE_MARGIN) / coloured, 0, 1)
        palette = np.round(255 * colours_of(skeleton.skin, shades)).astype(np.uint8)
        spec.add_texture(
            name=name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=PALETTE_WIDTH,
            height=1,
            nchannel=3,
            data=palette.ravel().tolist(),
        )
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        across = (PALETTE_MARGIN + mesh.shades * coloured + 0.5) / PALETTE_WIDTH
        skin.texcoord = np.stack([across, np.full_like(across, 0.5)], axis=1).ravel().tolist()
    skin.vert = mesh.points.ravel().tolist()
    skin.face = mesh.triangles.ravel().tolist()
    # MuJoCo refuses bones that no point follows.
    followed = np.unique(mesh.bones[mesh.weights > 0])
    skin.bodyname = [f"{prefix}bone{number}" for number in followed]
    skin.bindpos = mesh.bind_positions[followed].ravel().tolist()
    skin.bindquat = mesh.bind_orientations[followed].ravel().tolist()
    points_of_bones = []
    weights_of_bones = []
    for number in followed:
        weights = np.where(mesh.bones == number, mesh.weights, 0.0).sum(axis=1)
        points_of_bones.append(np.flatnonzero(weights > 0).tolist())
        weights_of_bones.append(weights[weights > 0].tolist())
    skin.vertid = points_of_bones
    skin.vertweight = weights_of_bones


def _add_surface(spec: mujoco.MjSpec, prefix: str, shapes: Shapes, is_ghost: bool) -> None:
    """Add a surface as a two-sided skin: MuJoCo draws only triangles that face the camera, each lit on its own."""
    name = f"{prefix}surface"
    material = spec.add_material(name=name, specular=0.1, shininess=0.2)
    material.rgba = GHOST_RGBA if is_ghost else CLOTH_RGBA
    skin = spec.add_skin(name=name, material=name)
    if is_ghost:
        skin.inflate = (GHOST_GROWTH - 1) * float(np.ptp(shapes.mean, axis=0).max())
    nodes = len(shapes.mean)
    back = shapes.faces[:, ::-1] + nodes
    skin.vert = np.tile(shapes.mean, (2, 1)).ravel().tolist()
    skin.face = np.concatenate([shapes.faces, back]).ravel().tolist()
    skin.bodyname = [f"{prefix}bone0"]
    skin.bindpos = [0.0, 0.0, 0.0]
    skin.bindquat = [1.0, 0.0, 0.0, 0.0]
    skin.vertid = [list(range(2 * nodes))]
    skin.vertweight = [[1.0] * (2 * nodes)]


def _place_mjcf(place: _Place, size: float, floor: float, surface: float | None) -> str:
    """Return the surroundings without the bodies, as MJCF; `floor` is the height of floor or seabed [m]."""
    wide = HALF_WIDTH * size
    water = ""
    if surface is not None:
        thin = WATER_THICKNESS * size
        water = f"""<geom type="box" pos="0 0 {surface - thin:.6g}" size="{wide:.6g} {wide:.6g} {thin:.6g}"
          rgba="0.5 0.72 0.84 0.25" contype="0" conaffinity="0"/>"""
    return f"""<mujoco>
      <statistic extent="{size:.6g}" center="0 0 0"/>
      <visual>
        <map {place.fading}/>
        <headlight ambient="0.43 0.45 0.47" diffuse="0.25 0.25 0.25" specular="0 0 0"/>
        <rgba fog="{place.horizon} 1"/>
      </visual>
      <asset>
        <texture type="skybox" builtin="gradient" rgb1="{place.sky}" rgb2="{place.horizon}" width="256" height="1536"/>
        <texture name="floor" type="2d" builtin="checker" rgb1="{place.floor}" rgb2="{place.squares}" width="512" height="512"/>
        <material name="floor" texture="floor" texuniform="true" texrepeat="{1 / size:.6g} {1 / size:.6g}" specular="0"/>
      </asset>
      <worldbody>
        <light type="directional" dir="-0.12 0.22 -1" diffuse="0.45 0.45 0.42" specular="0.2 0.2 0.2"/>
        <geom type="plane" pos="0 0 {floor:.6g}" size="{wide:.6g} {wide:.6g} 1" material="floor" contype="0" conaffinity="0"/>
        {water}
      </worldbody>
    </mujoco>"""
