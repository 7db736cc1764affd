"""The 570 real tosses of a cube onto a board of DAIRLab/contact-nets.

Pfrommer, Halm and Posa, "ContactNets" (CoRL 2020). Samples are 1/148 s apart; a run ends where the cube rests. The
authors give lengths in half widths of the cube (0.0524 m); here they are metres. Their velocities are differences of
neighbouring poses, passed through a median of three: that of the first sample is the difference to the second, plus a
whole step's gravity, as steps of semi-implicit Euler want it. Angular velocities are in the cube's own axes.

Physics in continuous time begins with another velocity, so the first state of a toss is that of the free flight fitted
to its first three samples, the same that the authors' median of three looks at.

The authors divide tosses at random anew in every run, unseeded, into half training, 30 % validation and 20 % test, so
there is no list of theirs to follow. Here the same shares come from a fixed seed; validation counts as training.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from benchmarks.real_recordings.runs import Columns, Run
from benchmarks.real_recordings.source_files import TOSSES, SourceFile, source_files
from benchmarks.real_recordings.torch_file import read_tensor

DT = 1 / 148
"""Sampling interval [s]."""

HALF_WIDTH = 0.0524
"""Half the width of the cube [m], the authors' unit of length."""

TRAINING_SHARE = 0.8
"""The authors' training and validation; the rest is unseen."""

SPLIT_SEED = 0

POSITION = slice(0, 3)
ORIENTATION = slice(3, 7)
VELOCITY = slice(7, 10)
ANGULAR_VELOCITY = slice(10, 13)
"""Columns of a state, here and in the authors' files; six zeros for a control stand behind them there."""

STATES = 13

START_SAMPLES = 3
"""Number of samples the first state of a toss is fitted to; the earliest toss touches the board after four."""

GRAVITY = 9.81
"""[m/s²]"""


def columns() -> Columns:
    """Return the columns of a recording of tosses, which nothing drives."""
    names = []
    for axis in range(3):
        names.append((f"cube.position.{axis}", "m"))
    for entry in range(4):
        names.append((f"cube.orientation.{entry}", "1"))
    for axis in range(3):
        names.append((f"cube.velocity.{axis}", "m/s"))
    for axis in range(3):
        names.append((f"cube.angular_velocity.{axis}", "rad/s"))
    return Columns(tuple(names), ())


def read_tosses(data: Path) -> tuple[list[Run], list[Run]]:
    """Return (the training tosses, the unseen tosses)."""
    files = source_files(TOSSES, "data/tosses_processed/")
    files.sort(key=_number)
    order = np.random.default_rng(SPLIT_SEED).permutation(len(files))
    runs = [_run(files[place], data) for place in order]
    border = round(TRAINING_SHARE * len(files))
    return runs[:border], runs[border:]


def _number(file: SourceFile) -> int:
    return int(Path(file.path).stem)


def _run(file: SourceFile, data: Path) -> Run:
    states = read_tensor(file.read(data))[0, :, :STATES]
    states[:, POSITION] *= HALF_WIDTH
    states[:, VELOCITY] *= HALF_WIDTH
    states[0] = flight_start(states[:START_SAMPLES])
    return Run(str(_number(file)), states, np.zeros((len(states), 0)))


def flight_start(states: Float[np.ndarray, "T S"]) -> Float[np.ndarray, " S"]:
    """Return the first state of a free flight whose poses are fitted to those of `states`, by least squares.

    A cube turns about a fixed axis: its moments of inertia are equal. Recorded velocities are not looked at.
    """
    time = DT * np.arange(len(states))
    lifted = states[:, POSITION].copy()
    lifted[:, 2] += GRAVITY / 2 * time**2  # what gravity takes away: straight lines are left
    velocity, position = np.polyfit(time, lifted, 1)
    orientations = Rotation.from_quat(states[:, ORIENTATION], scalar_first=True)
    first = orientations[0]
    turns = (first.inv() * orientations).as_rotvec()
    angular_velocity, offset = np.polyfit(time, turns, 1)
    orientation = (first * Rotation.from_rotvec(offset)).as_quat(scalar_first=True)
    if orientation @ states[0, ORIENTATION] < 0:
        orientation = -orientation
    return np.concatenate([position, orientation, velocity, angular_velocity])
