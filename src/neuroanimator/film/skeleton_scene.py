"""Bodies without a MuJoCo model: bones, skins and surfaces over a floor or in water."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, final

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.appearance.part_names import FLOOR, colour_names
from neuroanimator.appearance.shapes import Shapes, flesh_colours
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin_mesh import INFLUENCES, SkinMesh, colours_of, skin_mesh
from neuroanimator.export.ghost import GHOST_GROWTH, GHOST_RGBA
from neuroanimator.export.morphs import surface_normals
from neuroanimator.film.bounding_boxes import bounding_boxes
from neuroanimator.film.camera import Shots
from neuroanimator.film.options import Take
from neuroanimator.film.scene import FilmScene
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
    """The colours of a place, each 'red green blue'."""

    sky: str
    horizon: str
    floor: str
    squares: str
    fading: str
    """The distances at which it fades, over the body's size."""


FAR = 'fogstart="6" fogend="45"'
"""Fading in air."""

UNDER_WATER = _Place(
    "0.45 0.74 0.86",
    "0.12 0.38 0.52",
    "0.66 0.65 0.54",
    "0.64 0.63 0.525",
    'fogstart="3" fogend="16"',
)
OVER_WATER = _Place("0.5 0.68 0.86", "0.62 0.77 0.86", "0.12 0.34 0.46", "0.11 0.32 0.44", FAR)
ON_GROUND = _Place("0.5 0.68 0.86", "0.86 0.91 0.95", "0.75 0.75 0.76", "0.71 0.72 0.73", FAR)


@final
class SkeletonScene(FilmScene):
    """Bodies, and a ghost, moved from outside."""

    def __init__(self, take: Take, shots: Shots, system: System | None):
        """Put them into water or on ground, whichever their `system` is in; at a height of 0 without its physics."""
        floor = 0.0
        surface = None
        place = ON_GROUND
        depth = FLOOR_DEPTH * shots.size
        if system is not None and system.structure.is_in_water:
            surface = system.water_surface
            is_below = surface is None or shots.is_under_water
            place = UNDER_WATER if is_below else OVER_WATER
            depth = SEABED_DEPTH * shots.size
        if system is not None and not system.has_ground:
            floor = float(bounding_boxes(take.clips).low[:, 2].min()) - depth
        elif FLOOR in colour_names(take.clips[0].skeleton).values():
            floor = -depth
        spec = mujoco.MjSpec.from_string(_place_mjcf(place, shots.size, floor, surface))
        self._skeletons = [clip.skeleton for clip in take.everything]
        for number, skeleton in enumerate(self._skeletons):
            is_ghost = take.ghost is not None and number == len(take.clips)
            _add_skeleton(spec, number, skeleton, is_ghost)
        super().__init__(spec.compile(), shots)

    def pose(self, states: Sequence[Float[np.ndarray, " S"]]) -> None:
        """Set the bones to `states`."""
        self._states = states
        positions = []
        orientations = []
        for skeleton, state in zip(self._skeletons, states, strict=True):
            position, orientation = skeleton.world_poses(state[None])
            positions.append(position[0])
            orientations.append(orientation[0])
        self.data.mocap_pos[:] = np.concatenate(positions)
        self.data.mocap_quat[:] = np.concatenate(orientations)
        mujoco.mj_forward(self.model, self.data)

    def fill(self, picture: mujoco.MjvScene) -> None:
        """Fade distant things, let bodies in doubt glow, and move the nodes of surfaces."""
        super().fill(picture)
        for number, skeleton in enumerate(self._skeletons):
            if skeleton.shapes is not None:
                self._move_surface(picture, number, skeleton.shapes)
        picture.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        picture.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0
        for geom in picture.geoms[: picture.ngeom]:
            if geom.category == mujoco.mjtCatBit.mjCAT_STATIC:
                # The sea's surface would cast a shadow on its bed.
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR

    def _move_surface(self, picture: mujoco.MjvScene, number: int, shapes: Shapes) -> None:
        """Move both sides of the surface of body `number`, which MuJoCo has put at rest."""
        skin = self.model.skin(f"{number} surface")
        nodes = shapes.decode(self._states[number])
        normals = surface_normals(shapes, nodes)
        normals = np.concatenate([normals, -normals])
        points = np.tile(nodes, (2, 1)) + skin.inflate * normals
        first = 3 * picture.skinvertadr[skin.id]
        coordinates = slice(first, first + points.size)
        picture.skinvert[coordinates] = points.ravel()
        picture.skinnormal[coordinates] = normals.ravel()


def _add_skeleton(spec: mujoco.MjSpec, number: int, skeleton: Skeleton, is_ghost: bool) -> None:
    """Add the bones of body `number`, as bodies moved from outside, and its skin and surface.

    Bones that nothing moves are scenery, which only the first body has.
    """
    for index, bone in enumerate(skeleton.bones):
        body = spec.worldbody.add_body(
            name=f"{number} bone{index}", mocap=True, pos=bone.offset, quat=bone.orientation
        )
        if number and not skeleton.is_moved(index):
            continue
        for shape in bone.shapes:
            size = np.array([*shape.size, 0.0, 0.0][:3])
            body.add_geom(
                type=getattr(mujoco.mjtGeom, f"mjGEOM_{shape.kind.upper()}"),
                size=size * GHOST_GROWTH if is_ghost else size,
                pos=shape.position,
                quat=shape.orientation,
                rgba=GHOST_RGBA if is_ghost else shape.colour,
            )
    if skeleton.skin is not None:
        mesh = skin_mesh(skeleton)
        material = spec.add_material(name=f"{number} skin", specular=0.35, shininess=0.4)
        skin = _add_skin(spec, material, mesh, is_ghost)
        if not is_ghost:
            _colour(spec, material, skin, partial(colours_of, skeleton.skin), mesh.shades)
    if skeleton.shapes is not None:
        material = spec.add_material(name=f"{number} surface", specular=0.1, shininess=0.2)
        is_flesh = skeleton.shapes.shades is not None
        if not is_flesh:
            material.rgba = skeleton.shapes.rgba
        mesh = _two_sided(skeleton.shapes)
        skin = _add_skin(spec, material, mesh, is_ghost)
        if is_flesh and not is_ghost:
            _colour(spec, material, skin, flesh_colours, mesh.shades)


def _add_skin(
    spec: mujoco.MjSpec, material: mujoco.MjsMaterial, mesh: SkinMesh, is_ghost: bool
) -> mujoco.MjsSkin:
    """Return a new skin with the name of its `material`, which begins with its body's number."""
    skin = spec.add_skin(name=material.name, material=material.name)
    if is_ghost:
        material.rgba = GHOST_RGBA
        skin.inflate = (GHOST_GROWTH - 1) * float(np.ptp(mesh.points, axis=0).max())
    skin.vert = mesh.points.ravel().tolist()
    skin.face = mesh.triangles.ravel().tolist()
    # MuJoCo refuses bones that no point follows.
    followed = np.unique(mesh.bones[mesh.weights > 0])
    skin.bodyname = [f"{material.name.split()[0]} bone{index}" for index in followed]
    skin.bindpos = mesh.bind_positions[followed].ravel().tolist()
    skin.bindquat = mesh.bind_orientations[followed].ravel().tolist()
    points_of_bones = []
    weights_of_bones = []
    for index in followed:
        weights = np.where(mesh.bones == index, mesh.weights, 0.0).sum(axis=1)
        points_of_bones.append(np.flatnonzero(weights > 0).tolist())
        weights_of_bones.append(weights[weights > 0].tolist())
    skin.vertid = points_of_bones
    skin.vertweight = weights_of_bones
    return skin


def _colour(
    spec: mujoco.MjSpec,
    material: mujoco.MjsMaterial,
    skin: mujoco.MjsSkin,
    colours_at: Callable[[Float[np.ndarray, " W"]], Float[np.ndarray, "W 3"]],
    shades: Float[np.ndarray, " V"],
) -> None:
    """Give a skin, whose points have these `shades` from 0 to 1, its colours as a texture."""
    coloured = PALETTE_WIDTH - 1 - 2 * PALETTE_MARGIN
    shown = np.clip((np.arange(PALETTE_WIDTH) - PALETTE_MARGIN) / coloured, 0, 1)
    palette = np.round(255 * colours_at(shown)).astype(np.uint8)
    spec.add_texture(
        name=material.name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        width=PALETTE_WIDTH,
        height=1,
        nchannel=3,
        data=palette.ravel().tolist(),
    )
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = material.name
    across = (PALETTE_MARGIN + shades * coloured + 0.5) / PALETTE_WIDTH
    skin.texcoord = np.stack([across, np.full_like(across, 0.5)], axis=1).ravel().tolist()


def _two_sided(shapes: Shapes) -> SkinMesh:
    """Return both sides of a surface: MuJoCo draws only triangles that face the camera, each lit on its own."""
    points = np.tile(shapes.mean, (2, 1))
    back = shapes.faces[:, ::-1] + len(shapes.mean)
    return SkinMesh(
        points=points,
        normals=np.zeros_like(points),
        triangles=np.concatenate([shapes.faces, back]),
        bones=np.zeros((len(points), INFLUENCES), int),
        weights=np.tile(np.eye(INFLUENCES)[0], (len(points), 1)),
        shades=np.zeros(len(points)) if shapes.shades is None else np.tile(shapes.shades, 2),
        bind_positions=np.zeros((1, 3)),
        bind_orientations=np.eye(4)[:1],
    )


def _place_mjcf(place: _Place, size: float, floor: float, surface: float | None) -> str:
    """Return the surroundings without the bodies, as MJCF; `floor` is the height of floor or seabed [m]."""
    wide = HALF_WIDTH * size
    water = ""
    if surface is not None:
        thin = WATER_THICKNESS * size
        water = f"""<geom type="box" pos="0 0 {surface - thin:.6g}" size="{wide:.6g} {wide:.6g} {thin:.6g}"
          rgba="0.5 0.72 0.84 0.25"/>"""
    return f"""<mujoco>
      <option><flag contact="disable"/></option>
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
        <geom type="plane" pos="0 0 {floor:.6g}" size="{wide:.6g} {wide:.6g} 1" material="floor"/>
        {water}
      </worldbody>
    </mujoco>"""
