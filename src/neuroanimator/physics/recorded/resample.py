"""Samples at uneven times, put on an even grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.physics.recorded.rotations import entries_in, without_jumps
from neuroanimator.state.columns import Samples

ROUNDING = 1e-6
"""Share of a step by which the last sample may lie beyond the last time."""

MAX_BRIDGED = 4
"""Longest gap that is interpolated, in steps; a new run begins after a longer one."""


def on_even_grids(
    samples: Samples, begins: Int[np.ndarray, " B"], step: float, rotations: Sequence[slice]
) -> tuple[Samples, Int[np.ndarray, " R"]]:
    """Return the samples every `step` [s], and the rows at which runs after the first begin.

    States lie on cubic splines, angles unwrapped and quaternions of length 1; a control is the mean of those that acted.
    Of rows at the same time the first counts.
    """
    gaps = np.flatnonzero(np.diff(samples.time) > (MAX_BRIDGED + 0.5) * step) + 1
    cuts = np.union1d(begins, gaps)
    pieces = []
    for rows in np.split(np.arange(len(samples.time)), cuts):
        is_later = np.diff(samples.time[rows], prepend=-np.inf) > 0
        kept = rows[is_later]
        if len(kept) > 1:
            pieces.append(_even(samples, kept, step, rotations))
    sizes = np.cumsum([len(piece.time) for piece in pieces])
    names = ["time", "resolution", "states", "controls"]
    if samples.lines is not None:
        names.append("lines")
    joined = {name: np.concatenate([getattr(piece, name) for piece in pieces]) for name in names}
    run = np.repeat(np.arange(len(pieces)), np.diff(sizes, prepend=0))
    return replace(samples, run=run, **joined), sizes[:-1]


def _even(
    samples: Samples, rows: Int[np.ndarray, " N"], step: float, rotations: Sequence[slice]
) -> Samples:
    """Return one piece of a run, `rows`, on its grid."""
    # Imported here: it takes a quarter of a second, and most systems are not recorded.
    from scipy.interpolate import CubicSpline

    times = samples.time[rows]
    count = int((times[-1] - times[0]) / step + ROUNDING) + 1
    grid = np.minimum(times[0] + step * np.arange(count), times[-1])
    angles = entries_in(samples.state, "rad")
    states = CubicSpline(times, without_jumps(samples.states[rows], angles))(grid)
    for place in rotations:
        states[:, place] /= np.linalg.norm(states[:, place], axis=1, keepdims=True)
    edges = np.append(grid, grid[-1] + step)
    nearest = rows[np.minimum(np.searchsorted(times, grid), len(rows) - 1)]
    return replace(
        samples,
        run=samples.run[nearest],
        time=grid,
        resolution=samples.resolution[nearest],
        states=states,
        controls=held_means(np.append(times, times[-1] + step), samples.controls[rows], edges),
        lines=None if samples.lines is None else samples.lines[nearest],
    )


def held_means(
    times: Float[np.ndarray, " M"], held: Float[np.ndarray, "N C"], edges: Float[np.ndarray, " F"]
) -> Float[np.ndarray, "T C"]:
    """Return the means between `edges` of what is held from each of `times` to the next."""
    added = held * np.diff(times)[:, None]
    integral = np.concatenate([np.zeros((1, held.shape[1])), np.cumsum(added, axis=0)])
    whole = [np.interp(edges, times, column) for column in integral.T]
    if not whole:
        return np.zeros((len(edges) - 1, 0))
    return np.diff(np.stack(whole, axis=1), axis=0) / np.diff(edges)[:, None]
