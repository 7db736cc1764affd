"""The triangles of a skin in its bind pose, their colours, and the weights by which their points follow the bones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.appearance.loft import (
    Surface,
    ball_surface,
    body_surface,
    box_surface,
    fin_surface,
    joined,
    mirrored,
    normals_of,
)
from neuroanimator.appearance.mesh_skin import INFLUENCES, MeshSkin
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin import Box, Fin, Skin, Swimmer
from neuroanimator.state.rotation import rotation_matrices

BELLY = 0.0
"""Shade of a swimmer's belly: the position of its colour in the palette."""
BACK = 0.4
"""Shade of its back."""
FIN = 0.6
"""Shade of its fins."""
EYE = 0.8
"""Shade of its eyes."""
PUPIL = 1.0
"""Shade of their pupils."""

PARTS = ("body", "fin", "eye")
"""The parts of a swimmer's skin, in the order of their shades; a box is all body, and a model's skin has parts of its own."""

EYE_COLOUR = (0.93, 0.9, 0.82)
"""Red, green and blue of an eye: off-white."""

PUPIL_COLOUR = (0.03, 0.03, 0.04)
"""Red, green and blue of a pupil: nearly black."""

PUPIL_COSINE = 0.7
"""Cosine of the angle that the pupil spans, seen from the middle of the eye."""

EYE_DEPTH = 0.5
"""Thickness of the eye over its width, so that it does not bulge."""

BELLY_HEIGHT = 0.28
"""Share of a body's height below which it has its belly's colour."""

BELLY_TO_BACK = 0.42
"""Share of a body's height over which it darkens from there to the back."""

RIM_START = 0.7
"""Distance from the middle of a box's face, over half its side, from which the rim's colour begins to show."""

RIM_WIDTH = 0.2
"""Distance, over half the side, across which it turns fully into the rim's colour."""

MIN_HEIGHT = 1e-9
"""Smallest height of a body that is divided by [m]: it is 0 at the tips."""


class SkinMesh(NamedTuple):
    """A skin in the world, in its bind pose."""

    points: Float[np.ndarray, "V 3"]
    """Points of the skin [m]."""
    normals: Float[np.ndarray, "V 3"]
    """Outward normals at the points, of length 1."""
    triangles: Int[np.ndarray, "M 3"]
    """Numbers of points, counterclockwise from outside."""
    bones: Int[np.ndarray, "V 4"]
    """Bones each point follows."""
    weights: Float[np.ndarray, "V 4"]
    """Weight of each; they add up to 1."""
    shades: Float[np.ndarray, " V"]
    """Position of each point's colour in the palette, 0 to 1: see `colours_of`."""
    bind_positions: Float[np.ndarray, "B 3"]
    """Positions of all bones of the skeleton in the bind pose [m]; those that no point follows are anywhere."""
    bind_orientations: Float[np.ndarray, "B 4"]
    """Their quaternions wxyz."""

    @property
    def main_bones(self) -> Int[np.ndarray, " V"]:
        """The bone that each point follows most."""
        return self.bones[np.arange(len(self.bones)), self.weights.argmax(axis=1)]

    def points_of(self, bone: int, rows: np.ndarray) -> Float[np.ndarray, "N 3"]:
        """Return the points that `rows` selects, as seen from a bone in the bind pose [m]."""
        axes = rotation_matrices(self.bind_orientations[bone])
        return (self.points[rows] - self.bind_positions[bone]) @ axes


class _Influences(NamedTuple):
    """The bones each point follows, and how much."""

    bones: Int[np.ndarray, "V 4"]
    weights: Float[np.ndarray, "V 4"]


_Covering = tuple[Surface, Float[np.ndarray, " V"], _Influences]
"""A skin's surface, the shades of its V points and the bones they follow."""


def skin_mesh(skeleton: Skeleton) -> SkinMesh:
    """Return the skin around the bones of `skeleton`, which has one."""
    skin = skeleton.skin
    assert skin is not None
    bone_positions = np.array([bone.offset for bone in skeleton.bones])
    bone_orientations = np.array([bone.orientation for bone in skeleton.bones])
    if isinstance(skin, MeshSkin):
        surface, shades, influences = _triangles(skin)
        for bone in skin.bones:
            bone_positions[bone.number] = bone.position
            bone_orientations[bone.number] = bone.orientation
    elif isinstance(skin, Swimmer):
        surface, shades, influences = _swimmer(skin, bone_positions)
    else:
        surface, shades, influences = _box(skin, bone_positions)
    return SkinMesh(
        points=surface.points,
        normals=normals_of(surface),
        triangles=surface.triangles,
        bones=influences.bones,
        weights=influences.weights,
        shades=shades,
        bind_positions=bone_positions,
        bind_orientations=bone_orientations,
    )


def colours_of(skin: Skin, shades: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 3"]:
    """Return the colours (red, green, blue) at `shades`."""
    if isinstance(skin, Box):
        palette = {0.0: skin.face, 1.0: skin.rim or skin.face}
    elif isinstance(skin, MeshSkin):
        shades_of_parts = np.linspace(0, 1, len(skin.parts)).tolist()
        palette = {
            shade: part.colour for shade, part in zip(shades_of_parts, skin.parts, strict=True)
        }
    else:
        palette = {
            BELLY: skin.belly,
            BACK: skin.back,
            FIN: skin.fin or skin.back,
            EYE: EYE_COLOUR,
            PUPIL: PUPIL_COLOUR,
        }
    stops = list(palette)
    colours = np.array(list(palette.values()))
    channels = [np.interp(shades, stops, channel) for channel in colours.T]
    return np.stack(channels, axis=-1)


def parts_of(skin: Skin, mesh: SkinMesh) -> dict[str, Int[np.ndarray, " _"]]:
    """Return the numbers of the triangles of each part, by its name: one of `PARTS`, or as the model calls it."""
    if isinstance(skin, MeshSkin):
        names = [part.name for part in skin.parts]
        part_of = np.repeat(np.arange(len(names)), [part.triangles for part in skin.parts])
    elif isinstance(skin, Swimmer):
        names = list(PARTS)
        shades = mesh.shades[mesh.triangles].max(axis=1)
        part_of = np.digitize(shades, [(BACK + FIN) / 2, (FIN + EYE) / 2])
    else:
        names = list(PARTS)
        part_of = np.zeros(len(mesh.triangles), int)
    parts = {}
    for number, name in enumerate(names):
        triangles = np.flatnonzero(part_of == number)
        if len(triangles):
            parts[name] = triangles
    return parts


def _triangles(skin: MeshSkin) -> _Covering:
    arrays = skin.arrays
    shades = np.zeros(len(arrays.vertices))
    shades_of_parts = np.linspace(0, 1, len(skin.parts))
    first = 0
    for part, shade in zip(skin.parts, shades_of_parts, strict=True):
        shades[arrays.triangles[first : first + part.triangles]] = shade
        first += part.triangles
    surface = Surface(arrays.vertices, arrays.triangles)
    return surface, shades, _Influences(arrays.bones, arrays.weights)


def _swimmer(skin: Swimmer, bone_positions: Float[np.ndarray, "B 3"]) -> _Covering:
    sections = np.array(skin.sections)
    body = body_surface(sections)
    surfaces = [body]
    shades = [_countershade(body, sections)]
    for fin in skin.fins:
        for surface in _fins(fin):
            surfaces.append(surface)
            shades.append(np.full(len(surface.points), FIN))
    if skin.eye is not None:
        left, eye_shades = _left_eye(*skin.eye)
        surfaces += [left, mirrored(left)]
        shades += [eye_shades, eye_shades]
    whole = joined(surfaces)
    influences = _along_spine(whole.points[:, 0], bone_positions[:, 0])
    return whole, np.concatenate(shades), influences


def _fins(fin: Fin) -> list[Surface]:
    surface = fin_surface(np.array(fin.edge), fin.thickness)
    if fin.both:
        return [surface, mirrored(surface)]
    return [surface]


def _left_eye(
    x: float, y: float, z: float, radius: float
) -> tuple[Surface, Float[np.ndarray, " V"]]:
    """Return the left eye at x, y, z [m] and its shades."""
    ball = ball_surface(np.zeros(3), radius)
    is_pupil = ball.points[:, 1] > PUPIL_COSINE * radius
    points = ball.points * [1, EYE_DEPTH, 1] + [x, y, z]
    return Surface(points, ball.triangles), np.where(is_pupil, PUPIL, EYE)


def _countershade(body: Surface, sections: Float[np.ndarray, "K 4"]) -> Float[np.ndarray, " V"]:
    """Return a shade per point: light below and dark above, as in animals lit from above."""
    order = np.argsort(sections[:, 0])
    x, _, top, bottom = sections[order].T
    tops = np.interp(body.points[:, 0], x, top)
    bottoms = np.interp(body.points[:, 0], x, bottom)
    height = (body.points[:, 2] - bottoms) / np.maximum(tops - bottoms, MIN_HEIGHT)
    darkness = _smooth_step((height - BELLY_HEIGHT) / BELLY_TO_BACK)
    return BELLY + (BACK - BELLY) * darkness


def _along_spine(x: Float[np.ndarray, " V"], stations: Float[np.ndarray, " B"]) -> _Influences:
    """Return the two bones each point follows, and how much, by its position along X."""
    order = np.argsort(stations)
    share = np.interp(x, stations[order], np.arange(len(order)))
    below = np.clip(share.astype(int), 0, max(len(order) - 2, 0))
    above = np.minimum(below + 1, len(order) - 1)
    weight = _smooth_step(share - below)
    no_bone = 0 * below
    no_weight = 0 * weight
    bones = np.stack([order[below], order[above], no_bone, no_bone], axis=1)
    weights = np.stack([1 - weight, weight, no_weight, no_weight], axis=1)
    return _Influences(bones, weights)


def _box(skin: Box, bone_positions: Float[np.ndarray, "8 3"]) -> _Covering:
    """Return a box around eight corners; bone 4a + 2b + c is the one at the a-th end of X, b-th of Y, c-th of Z."""
    low = bone_positions.min(axis=0)
    high = bone_positions.max(axis=0)
    half = np.ptp(bone_positions, axis=0) / 2 + skin.margin
    surface, sharp = box_surface(half, skin.rounding * half.min())
    rim_distance = np.sort(np.abs(sharp), axis=1)[:, 1]
    shades = _smooth_step((rim_distance - RIM_START) / RIM_WIDTH)
    moved = Surface(surface.points + (low + high) / 2, surface.triangles)
    return moved, shades, _nearest_corners(sharp)


def _nearest_corners(sharp: Float[np.ndarray, "V 3"]) -> _Influences:
    """Return the corners each point follows, and how much; points are -1 to 1 along every axis of the box."""
    ends = np.stack([(1 - sharp) / 2, (1 + sharp) / 2], axis=1)
    along_x = ends[:, :, None, None, 0]
    along_y = ends[:, None, :, None, 1]
    along_z = ends[:, None, None, :, 2]
    trilinear = (along_x * along_y * along_z).reshape(-1, 8)
    bones = np.argsort(-trilinear, axis=1, kind="stable")[:, :INFLUENCES]
    weights = np.take_along_axis(trilinear, bones, axis=1)
    return _Influences(bones, weights / weights.sum(axis=1, keepdims=True))


def _smooth_step(share: Float[np.ndarray, " V"]) -> Float[np.ndarray, " V"]:
    """Return 0 below 0, 1 above 1 and a smooth step between."""
    share = np.clip(share, 0, 1)
    return share * share * (3 - 2 * share)
