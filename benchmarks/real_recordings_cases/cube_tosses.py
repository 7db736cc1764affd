"""The 570 real tosses of a cube onto a board of DAIRLab/contact-nets.

Pfrommer, Halm and Posa, "ContactNets" (CoRL 2020). Samples are 1/148 s apart; a run ends where the cube rests. The
authors give lengths in half widths of the cube (0.0524 m); here they are metres. Their velocities are differences of
neighbouring poses, passed through a median of three: that of the first sample is the difference to the second.
Angular velocities are in the cube's own axes.

The authors divide tosses at random anew in every run, unseeded, into half training, 30 % validation and 20 % test, so
there is no list of theirs to follow. Here the same shares come from a fixed seed; validation counts as training.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from real_recordings_cases.runs import Columns, Run
from real_recordings_cases.source_files import TOSSES, SourceFile, source_files
from real_recordings_cases.torch_file import read_tensor

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


def columns() -> Columns:
    """Return the columns of a recording of tosses, which nothing drives."""
    names = []
    for axis in "xyz":
        names.append((f"cube.position.{axis}", "m"))
    for entry in "wxyz":
        names.append((f"cube.orientation.{entry}", "1"))
    for axis in "xyz":
        names.append((f"cube.velocity.{axis}", "m/s"))
    for axis in "xyz":
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
    return Run(str(_number(file)), states, np.zeros((len(states), 0)))
