"""The triangles of a skin, and how its points follow the bones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin import Box, Fin, Skin, Swimmer
from neuroanimator.state.rotation import rotate, rotate_back

INFLUENCES = 4
"""Bones per point, as glTF has them."""
BELLY, BACK, FIN, EYE, PUPIL = 0.0, 0.4, 0.6, 0.8, 1.0
"""Shades: where a point's colour lies in the palette."""
EYE_COLOURS = (0.93, 0.9, 0.82), (0.03, 0.03, 0.04)
"""Of the eye and its pupil."""
PUPIL_SHARE = 0.7
"""Cosine of the angle to which the pupil reaches."""
EYE_DEPTH = 0.5
"""Thickness of the eye over its width."""


class SkinMesh(NamedTuple):
    """A skin at rest, in the world."""

    points: np.ndarray
    """(V, 3) [m]"""
    normals: np.ndarray
    """(V, 3), unit length, outward"""
    triangles: np.ndarray
    """(M, 3), counterclockwise from outside"""
    bones: np.ndarray
    """(V, 4) bones each point follows"""
    weights: np.ndarray
    """(V, 4), adding up to 1"""
    shades: np.ndarray
    """(V,) 0 to 1, see `colours_of`"""


def skin_mesh(skeleton: Skeleton) -> SkinMesh:
    """Return the skin around the bones of `skeleton`, which has one."""
    skin = skeleton.skin
    assert skin is not None
    positions = np.array([bone.offset for bone in skeleton.bones])
    surface, shades, (bones, weights) = (
        _swimmer(skin, positions) if isinstance(skin, Swimmer) else _box(skin, positions)
    )
    return SkinMesh(surface.points, normals_of(surface), surface.triangles, bones, weights, shades)


def colours_of(skin: Skin, shades: np.ndarray) -> np.ndarray:
    """Return the colours (N, 3) at `shades` (N,)."""
    if isinstance(skin, Box):
        stops, colours = [0.0, 1.0], [skin.face, skin.rim or skin.face]
    else:
        stops, colours = (
            [BELLY, BACK, FIN, EYE, PUPIL],
            [skin.belly, skin.back, skin.fin or skin.back, *EYE_COLOURS],
        )
    return np.stack(
        [np.interp(shades, stops, channel) for channel in zip(*colours, strict=True)], axis=-1
    )


def posed(skeleton: Skeleton, mesh: SkinMesh, states: np.ndarray) -> np.ndarray:
    """Return the points (T, V, 3) of the skin [m] for states (T, S): every point carried by its bones."""
    positions, orientations = skeleton.world_poses(states)
    found = np.zeros((len(states), *mesh.points.shape))
    for i, bone in enumerate(skeleton.bones):
        own = rotate_back(np.array(bone.orientation)[None], mesh.points - np.array(bone.offset))
        carried = positions[:, i, None] + rotate(orientations[:, i, None], own[None])
        found += np.where(mesh.bones == i, mesh.weights, 0.0).sum(axis=1)[:, None] * carried
    return found


def _swimmer(
    skin: Swimmer, positions: np.ndarray
) -> tuple[Surface, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    body = body_surface(np.array(skin.sections))
    parts = [(body, _countershade(body, np.array(skin.sections)))]
    for fin in skin.fins:
        parts += [(surface, np.full(len(surface.points), FIN)) for surface in _fins(fin)]
    if skin.eye is not None:
        parts += _eyes(*skin.eye)
    surface = joined([part for part, _ in parts])
    return (
        surface,
        np.concatenate([shades for _, shades in parts]),
        _along_spine(surface.points[:, 0], positions[:, 0]),
    )


def _fins(fin: Fin) -> list[Surface]:
    surface = fin_surface(np.array(fin.edge), fin.thickness)
    return [surface, mirrored(surface)] if fin.both else [surface]


def _eyes(x: float, y: float, z: float, radius: float) -> list[tuple[Surface, np.ndarray]]:
    ball = ball_surface(np.zeros(3), radius)
    shades = np.where(ball.points[:, 1] > PUPIL_SHARE * radius, PUPIL, EYE)
    left = Surface(ball.points * [1, EYE_DEPTH, 1] + [x, y, z], ball.triangles)
    return [(left, shades), (mirrored(left), shades)]


def _countershade(body: Surface, sections: np.ndarray) -> np.ndarray:
    """Return a shade per point: light below, dark above, as animals are that are lit from above."""
    order = np.argsort(sections[:, 0])
    x, _, top, bottom = sections[order].T
    tops, bottoms = (np.interp(body.points[:, 0], x, side) for side in (top, bottom))
    height = (body.points[:, 2] - bottoms) / np.maximum(tops - bottoms, 1e-9)
    return BELLY + (BACK - BELLY) * _soft((height - 0.28) / 0.42)


def _along_spine(at: np.ndarray, stations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the two bones each point follows, and how much, by its place along X."""
    order = np.argsort(stations)
    share = np.interp(at, stations[order], np.arange(len(order)))
    below = np.clip(share.astype(int), 0, max(len(order) - 2, 0))
    above = np.minimum(below + 1, len(order) - 1)
    weight = _soft(share - below)
    bones = np.stack([order[below], order[above], 0 * below, 0 * below], axis=1)
    return bones, np.stack([1 - weight, weight, 0 * weight, 0 * weight], axis=1)


def _box(
    skin: Box, positions: np.ndarray
) -> tuple[Surface, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return a box around eight corners; bone 4a + 2b + c is the one at the a-th end of X, b-th of Y, c-th of Z."""
    centre = (positions.min(axis=0) + positions.max(axis=0)) / 2
    half = np.ptp(positions, axis=0) / 2 + skin.margin
    surface, sharp = box_surface(half, skin.rounding * half.min())
    near = np.stack([(1 - sharp) / 2, (1 + sharp) / 2], axis=1)
    weights = (
        near[:, :, None, None, 0] * near[:, None, :, None, 1] * near[:, None, None, :, 2]
    ).reshape(-1, 8)
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
    kept = np.take_along_axis(weights, bones, axis=1)
    rim = np.sort(np.abs(sharp), axis=1)[:, 1]
    shades = _soft((rim - 0.7) / 0.2)
    moved = Surface(surface.points + centre, surface.triangles)
    return moved, shades, (bones, kept / kept.sum(axis=1, keepdims=True))


def _soft(share: np.ndarray) -> np.ndarray:
    """Return 0 below 0, 1 above 1 and a smooth step between."""
    share = np.clip(share, 0, 1)
    return share * share * (3 - 2 * share)
