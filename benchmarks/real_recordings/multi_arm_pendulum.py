"""The real triple and the real double pendulum of dynamicslab/MultiArm-Pendulum, swinging freely on a cart that is held.

Kaheman et al., "The Experimental Multi-Arm Pendulum on a Cart" (2022). What is read are the authors' recordings for
parameter estimation: one free swing of 40 s (triple) and of 80 s (double) at 1 kHz, cut by them into pieces that follow
each other without a gap. There are two splits:

* authors': their first 22 (triple) and 26 (double) pieces are training, as their parameters were fitted to them; their
  last 4, for validation, are unseen. These are the ends of a dying swing: far calmer than training.
* every fifth: pieces 3, 8, 13 and so on of all are unseen, so unseen motion is as lively as training. The authors'
  parameters were fitted to most of these pieces; nobody else's may be.

The authors' angles are those of links against the upright; here each is that of a hinge, against the link above, zero
when hanging.

Their other recordings (free swings, and with a moving cart) are files of more than 4 MB each and are not used.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.io import loadmat

from benchmarks.real_recordings.runs import Run, half_states, sampled_states
from benchmarks.real_recordings.source_files import MULTI_ARM, source_file

RECORDED_DT = 1e-3
"""The authors' sampling interval [s]."""

WIDTH = 0.03
"""Velocities are slopes over so long [s]."""


EVERY = 5
FIRST = 2
"""With the split "every fifth", pieces FIRST, FIRST + EVERY and so on, counted from 0, are unseen."""


def read_swing(name: str, data: Path) -> tuple[list[Run], list[Run]]:
    """Return (the training part, the unseen part) of the "Triple" or the "Double" pendulum's swing, split by the authors."""
    training, unseen = _pieces(name, data)
    whole = [np.concatenate(training), np.concatenate(unseen)]
    return [_run("training", whole[0])], [_run("unseen", whole[1])]


def read_swing_by_fifths(name: str, data: Path) -> tuple[list[Run], list[Run]]:
    """Return (four fifths of the swing in stretches without a gap, every fifth piece)."""
    first, last = _pieces(name, data)
    pieces = first + last
    training = []
    unseen = []
    stretch: list[Float[np.ndarray, "T L"]] = []
    for number, piece in enumerate(pieces):
        if number % EVERY == FIRST:
            unseen.append(_run(f"piece_{number}", piece))
            training.append(_run(f"before_{number}", np.concatenate(stretch)))
            stretch = []
        else:
            stretch.append(piece)
    if stretch:
        training.append(_run("last", np.concatenate(stretch)))
    return training, unseen


def _pieces(
    name: str, data: Path
) -> tuple[list[Float[np.ndarray, "T L"]], list[Float[np.ndarray, "T L"]]]:
    """Return the links' angles [rad] in the authors' pieces (for estimation, for validation)."""
    path = f"ParameterEstimation/{name}Pendulum/{name}PendulumDataForParameterEstimation.mat"
    content = source_file(MULTI_ARM, path).read(data)
    tables = loadmat(io.BytesIO(content))
    return _links(tables["Y_id"]), _links(tables["Y_vad"])


def _links(cells: np.ndarray) -> list[Float[np.ndarray, "T L"]]:
    pieces = []
    for cell in cells:
        rows = cell[0]
        links = len(rows) // 2  # the other rows are velocities, as the authors filtered them
        pieces.append(rows[:links].T)
    return pieces


def _run(name: str, links: Float[np.ndarray, "T L"]) -> Run:
    hanging = links - np.pi
    hinges = np.diff(hanging, axis=1, prepend=0.0)
    time = RECORDED_DT * np.arange(len(hinges))
    states = sampled_states(time, hinges, WIDTH)
    return Run(name, states, np.zeros((len(states), 0)), half_states(time, hinges, WIDTH))
