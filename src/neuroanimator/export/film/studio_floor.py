"""A floor under what would hang in an empty sky: tiles that show how large things are, and no end.

It is that of the studio's stage, where nothing says what ground there is.
"""

from __future__ import annotations

from typing import NamedTuple, final

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.export.film.camera import Shots

DEPTH = 0.08
"""Depth of the floor under the lowest point of the motion, over the body's size."""

HALF_WIDTH = 60.0
"""Half the width of the floor, over the body's size."""

TILED = 6.0
"""Half the width of what has tiles, over the body's size: farther away all has faded."""

MAX_TILES = 30
"""Tiles in either direction, at most."""

TILE_HEIGHT = 0.0004
"""How far tiles lie over the floor, over the body's size: far enough not to flicker with it."""

FADING = (3.0, 14.0)
"""From where on the floor fades into what is behind it, and where it has faded, over the camera's distance."""

DARKER = 0.86
"""The floor's brightness, over that of what is behind it."""

TILES_DARKER = 0.94
"""The brightness of every other tile, over the floor's: as much as is seen, and too little to flicker far away."""

LEAST_BRIGHTNESS = 0.075
"""Of a floor where all is black behind it."""

HEADLIGHT = 0.2
"""How brightly the lamp at the camera shines at most, where there are others: a floor seen from above must not glare."""

POST = 0.014
"""Half the thickness of a stand's post, over its height."""

AXLE = 0.07
"""How far behind a joint its stand is, over its height: what swings there goes by."""

FOOT = 0.1
"""Radius of a stand's foot, over its height."""

LEVEL = 0.5
"""A joint turns about a level axis if the axis' unit vector rises by less: what hangs from it gets a stand."""

STEEL = np.array([0.36, 0.39, 0.43])
"""The colour of stands."""

GROUND_TYPES = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
"""Shapes that nothing but ground has."""


class Pivot(NamedTuple):
    """A joint that a body hangs from."""

    position: Float[np.ndarray, " 3"]
    """[m]"""
    axis: Float[np.ndarray, " 3"]
    """A unit vector."""


class _Colours(NamedTuple):
    behind: Float[np.ndarray, " 3"]
    """What is seen at the horizon."""
    floor: Float[np.ndarray, " 3"]
    tiles: Float[np.ndarray, " 3"]


@final
class StudioFloor:
    """A floor that is drawn and that nothing touches, with a stand for what hangs from nothing."""

    def __init__(self, model: mujoco.MjModel, pivots: list[Pivot], lowest: float, shots: Shots):
        """Lay it under `lowest` [m], the lowest point of what `shots` show, and put stands behind `pivots`.

        The model's lamps become suns, which leave no bright spot on the floor, and what is far away fades.
        """
        size = shots.size
        distance = shots.distance
        ahead = shots.lookat[0] - shots.position[0]
        self._stands = [_stand_behind(pivot, ahead) for pivot in pivots]
        self._height = lowest - DEPTH * size
        self._size = size
        self._colours = _colours_of(model)
        is_of_the_world = model.light_bodyid == 0
        model.light_type[is_of_the_world] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        if is_of_the_world.any():
            headlight = model.vis.headlight
            headlight.diffuse[:] = np.minimum(headlight.diffuse, HEADLIGHT)
        extent = model.stat.extent
        near, far = FADING
        model.vis.map.fogstart = near * distance / extent
        model.vis.map.fogend = far * distance / extent
        model.vis.rgba.fog[:3] = self._colours.behind

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Let what is far away fade."""
        scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
        scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0

    def fill(self, scene: mujoco.MjvScene, middle: Float[np.ndarray, " 3"]) -> None:
        """Add the floor around `middle` [m] to `scene`; its tiles stay where they are."""
        wide = HALF_WIDTH * self._size
        _add(
            scene,
            mujoco.mjtGeom.mjGEOM_PLANE,
            [wide, wide, 1.0],
            [middle[0], middle[1], self._height],
            self._colours.floor,
        )
        side = 10.0 ** round(np.log10(self._size))
        count = min(round(TILED * self._size / side), MAX_TILES // 2)
        nearest = np.round(middle[:2] / side).astype(int)
        half_sizes = [side / 2, side / 2, 1.0]
        height = self._height + TILE_HEIGHT * self._size
        around = np.arange(-count, count + 1)
        for column in nearest[0] + around:
            for row in nearest[1] + around:
                if (column + row) % 2 == 0:
                    place = [column * side, row * side, height]
                    _add(scene, mujoco.mjtGeom.mjGEOM_PLANE, half_sizes, place, self._colours.tiles)
        for stand in self._stands:
            self._add_stand(scene, stand)

    def _add_stand(self, scene: mujoco.MjvScene, stand: Pivot) -> None:
        """Add an axle from a joint to a post behind it, and its foot on the floor."""
        height = stand.position[2] - self._height
        width = POST * height
        top = stand.position + AXLE * height * stand.axis
        bottom = np.array([top[0], top[1], self._height])
        thin = 0.5 * width
        foot = [FOOT * height, thin, 0.0]
        foot_place = [bottom[0], bottom[1], self._height + thin]
        for start in (stand.position, bottom):
            post = _add(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, [width] * 3, top, STEEL)
            if post is not None:
                mujoco.mjv_connector(post, mujoco.mjtGeom.mjGEOM_CAPSULE, width, start, top)
                post.category = mujoco.mjtCatBit.mjCAT_STATIC
        _add(scene, mujoco.mjtGeom.mjGEOM_CYLINDER, foot, foot_place, STEEL)


def lacks_ground(model: mujoco.MjModel, size: float) -> bool:
    """Return whether nothing in `model` is ground for a body of `size` [m]: no plane, no terrain and no broad block."""
    is_ground = np.isin(model.geom_type, GROUND_TYPES)
    is_fixed = model.body_weldid[model.geom_bodyid] == 0
    is_broad = is_fixed & (model.geom_rbound > size)
    return not (is_ground | is_broad).any()


def pivots_of(model: mujoco.MjModel, data: mujoco.MjData) -> list[Pivot]:
    """Return the joints by which bodies hang from a world in which nothing stands: those that turn about a level axis."""
    if (model.body_weldid[model.geom_bodyid] == 0).any():
        return []
    pivots = []
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE):
        parent = model.body_parentid[model.jnt_bodyid[joint]]
        axis = data.xaxis[joint]
        if model.body_weldid[parent] == 0 and abs(axis[2]) < LEVEL:
            pivots.append(Pivot(data.xanchor[joint].copy(), axis.copy()))
    return pivots


def _stand_behind(pivot: Pivot, ahead: Float[np.ndarray, " 3"]) -> Pivot:
    """Return `pivot` with the axis that leads away from a camera that looks along `ahead`."""
    if pivot.axis @ ahead < 0:
        return pivot._replace(axis=-pivot.axis)
    return pivot


def lowest_of_fixed(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the height of the lowest point of what never moves [m]; infinite where there is no such thing."""
    lowest = np.inf
    for geom in np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0):
        axes = data.geom_xmat[geom].reshape(3, 3)
        centre = data.geom_xpos[geom] + axes @ model.geom_aabb[geom, :3]
        half = np.abs(axes) @ model.geom_aabb[geom, 3:]
        lowest = min(lowest, float(centre[2] - half[2]))
    return lowest


def _colours_of(model: mujoco.MjModel) -> _Colours:
    """Return the colours that go with the model's sky, or with the black where it has none."""
    behind = np.zeros(3)
    skies = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    if len(skies):
        behind = _horizon(model, int(skies[0]))
    floor = np.maximum(DARKER * behind, LEAST_BRIGHTNESS)
    return _Colours(behind, floor, TILES_DARKER * floor)


def _horizon(model: mujoco.MjModel, sky: int) -> Float[np.ndarray, " 3"]:
    """Return the colour of a sky's texture at the horizon: halfway down the four faces at its sides."""
    width = model.tex_width[sky]
    channels = model.tex_nchannel[sky]
    start = model.tex_adr[sky]
    size = model.tex_height[sky] * width * channels
    texels = model.tex_data[start : start + size].reshape(-1, width, width, channels)
    if len(texels) < 6:
        return texels[0].reshape(-1, channels)[:, :3].mean(axis=0) / 255
    # Faces: right, left, up, down, front, back.
    sides = texels[[0, 1, 4, 5]]
    return sides[:, width // 2, :, :3].mean(axis=(0, 1)) / 255


def _add(
    scene: mujoco.MjvScene,
    geom_type: mujoco.mjtGeom,
    size: list[float] | np.ndarray,
    place: list[float] | np.ndarray,
    colour: Float[np.ndarray, " 3"],
) -> mujoco.MjvGeom | None:
    """Add a dull shape that casts no shadow to `scene`, and return it; None if there is no room in it."""
    if scene.ngeom >= scene.maxgeom:
        return None
    geom = scene.geoms[scene.ngeom]
    scene.ngeom += 1
    rgba = np.array([*colour, 1], np.float32)
    mujoco.mjv_initGeom(
        geom, geom_type, np.array(size, float), np.array(place, float), np.eye(3).ravel(), rgba
    )
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.specular = 0
    return geom
