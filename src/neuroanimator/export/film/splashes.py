"""Where bodies break through the water: drops that fly up, and foam that spreads and fades. The same every time."""

from __future__ import annotations

from typing import NamedTuple, final

import mujoco
import numpy as np
from jaxtyping import Float, Int

GRAVITY = 9.81
"""[m/s²] What brings the drops back."""

SLOWEST = 0.2
"""A bone throws up water if it crosses the surface faster than this, over what it would fall at after its body's size."""

FASTEST = 0.6
"""At this, over the same, as much water flies as does at all."""

HEIGHT = 0.35
"""How high the fastest drops rise, over the body's size."""

DROPS = 26
"""Drops that a bone throws up at most."""

DROP_LENGTH = 0.012
"""[s] A drop is drawn as the way it flies in this time, as on a photograph."""

DROP_WIDTH = 0.0035
"""Half the thickness of a drop, over the body's size."""

SPREAD = 0.17
"""How far around the bone drops begin, over the body's size."""

SIDEWARD = 0.45
"""How fast drops fly aside at most, over how fast they rise."""

FOAM_SECONDS = 1.1
"""[s] After this time foam has gone."""

FOAM_SIZES = (0.05, 0.26)
"""Radius of foam at first and at last, over the body's size."""

FOAM_OPACITY = 0.2
"""Opacity of foam at first."""

FOAM_HEIGHT = 0.003
"""How far foam lies over the surface, over the body's size: far enough not to flicker with it."""

WHITE = (0.93, 0.97, 1.0)
"""The colour of drops and foam."""


class _Crossings(NamedTuple):
    """Where bones cross the surface."""

    times: Float[np.ndarray, " K"]
    """[s] Since the first image."""
    places: Float[np.ndarray, "K 2"]
    """[m] In the plane."""
    strengths: Float[np.ndarray, " K"]
    """How fast, from 0 to 1."""


@final
class Splashes:
    """The drops and the foam of a motion: where they are follows from the time alone."""

    def __init__(
        self,
        positions: Float[np.ndarray, "F B 3"],
        rate: float,
        surface: float,
        size: float,
    ):
        """Find where bones at `positions` [m], `rate` images a second, cross the `surface` [m]; `size` is a body's [m]."""
        crossings = _crossings(positions, rate, surface, size)
        self._rate = rate
        self._surface = surface
        self._size = size
        self._crossings = crossings
        counts = np.ceil(DROPS * crossings.strengths).astype(int)
        self._began, self._starts, self._velocities = _drops(crossings, counts, surface, size)

    def fill(self, scene: mujoco.MjvScene, frame: int) -> None:
        """Add what is seen in `frame` to `scene`, as far as there is room in it."""
        now = frame / self._rate
        self._add_foam(scene, now)
        self._add_drops(scene, now)

    def _add_foam(self, scene: mujoco.MjvScene, now: float) -> None:
        ages = now - self._crossings.times
        first, last = FOAM_SIZES
        for number in np.flatnonzero((ages >= 0) & (ages < FOAM_SECONDS)):
            share = ages[number] / FOAM_SECONDS
            strength = self._crossings.strengths[number]
            radius = self._size * (first + (last - first) * np.sqrt(share)) * (0.5 + 0.5 * strength)
            opacity = FOAM_OPACITY * strength * (1 - share) ** 2
            place = [*self._crossings.places[number], self._surface + FOAM_HEIGHT * self._size]
            thin = 0.2 * FOAM_HEIGHT * self._size
            geom = _next_geom(scene)
            if geom is None:
                return
            mujoco.mjv_initGeom(
                geom,
                mujoco.mjtGeom.mjGEOM_ELLIPSOID,
                np.array([radius, radius, thin]),
                np.array(place),
                np.eye(3).ravel(),
                np.array([*WHITE, opacity], np.float32),
            )

    def _add_drops(self, scene: mujoco.MjvScene, now: float) -> None:
        ages = now - self._began
        flying = np.flatnonzero((ages >= 0) & (ages < 2 * self._velocities[:, 2] / GRAVITY))
        age = ages[flying, None]
        velocities = self._velocities[flying] - GRAVITY * age * [0, 0, 1]
        middle = (self._velocities[flying] + velocities) / 2
        heads = self._starts[flying] + middle * age
        tails = heads - velocities * DROP_LENGTH
        width = DROP_WIDTH * self._size
        orientation = np.empty(4)
        axes = np.empty(9)
        for head, tail in zip(heads, tails, strict=True):
            geom = _next_geom(scene)
            if geom is None:
                return
            along = head - tail
            mujoco.mju_quatZ2Vec(orientation, along)
            mujoco.mju_quat2Mat(axes, orientation)
            mujoco.mjv_initGeom(
                geom,
                mujoco.mjtGeom.mjGEOM_BOX,
                np.array([width, width, np.linalg.norm(along) / 2 + width]),
                (head + tail) / 2,
                axes,
                np.array([*WHITE, 1], np.float32),
            )


def _crossings(
    positions: Float[np.ndarray, "F B 3"], rate: float, surface: float, size: float
) -> _Crossings:
    """Return where bones cross the surface fast, in order of time."""
    heights = positions[..., 2] - surface
    velocities = np.diff(heights, axis=0) * rate
    falling = np.sqrt(2 * GRAVITY * size)
    crosses = (heights[:-1] < 0) != (heights[1:] < 0)
    frames, bones = np.nonzero(crosses & (np.abs(velocities) > SLOWEST * falling))
    below = heights[frames, bones]
    share = below / (below - heights[frames + 1, bones])
    before = positions[frames, bones, :2]
    after = positions[frames + 1, bones, :2]
    strengths = np.minimum(np.abs(velocities[frames, bones]) / (FASTEST * falling), 1.0)
    return _Crossings(
        (frames + share) / rate, before + share[:, None] * (after - before), strengths
    )


def _drops(
    crossings: _Crossings, counts: Int[np.ndarray, " K"], surface: float, size: float
) -> tuple[Float[np.ndarray, " D"], Float[np.ndarray, "D 3"], Float[np.ndarray, "D 3"]]:
    """Return when [s], where [m] and how fast [m/s] drops begin, `counts` of them at each crossing."""
    rng = np.random.default_rng(0)
    of = np.repeat(np.arange(len(counts)), counts)
    angle = rng.uniform(0, 2 * np.pi, len(of))
    ways = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    fastest = np.sqrt(2 * GRAVITY * HEIGHT * size)
    rising = fastest * crossings.strengths[of] * rng.uniform(0.3, 1.0, len(of))
    aside = ways * (SIDEWARD * rising * rng.random(len(of)))[:, None]
    around = ways * (SPREAD * size * rng.random(len(of)))[:, None]
    starts = np.column_stack([crossings.places[of] + around, np.full(len(of), surface)])
    return crossings.times[of], starts, np.column_stack([aside, rising])


def _next_geom(scene: mujoco.MjvScene) -> mujoco.MjvGeom | None:
    """Return the next free shape of `scene`, now in use and mere decoration; None where all are in use."""
    if scene.ngeom >= scene.maxgeom:
        return None
    geom = scene.geoms[scene.ngeom]
    scene.ngeom += 1
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    return geom
