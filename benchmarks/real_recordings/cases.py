"""The cases of the benchmark: a recording, its model, and the windows in which methods are compared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from benchmarks.real_recordings import cube_tosses
from benchmarks.real_recordings.multi_arm_pendulum import read_swing, read_swing_by_fifths
from benchmarks.real_recordings.robot import read_excitation, read_pendubot
from benchmarks.real_recordings.runs import DT, Columns, Run, hinge_columns

MODELS = Path(__file__).parent

HORIZONS = (0.1, 0.25, 0.5, 1.0)
"""Errors are told after these times [s]."""

WINDOW = 1.0
"""Length of a window of a pendulum's motion [s]."""

SPACING = 0.1
"""Windows begin so far apart [s]; they overlap."""

TORQUES = (("torque1", "N·m"), ("torque2", "N·m"))


@dataclass(frozen=True)
class Case:
    """A real body, its recording and its model."""

    name: str
    model_file: str
    """An MJCF file beside this one, with its authors' parameters."""
    columns: Columns
    dt: float
    """The sampling interval [s]."""
    read: Callable[[Path], tuple[list[Run], list[Run]]]
    """Returns the training and the unseen runs from a folder of checkouts."""
    own_model_file: str = ""
    """An MJCF file of ours, which has more to fit; if empty the authors' model is fitted."""

    @property
    def is_cube(self) -> bool:
        """Whether the body moves freely: position and orientation, not angles of hinges."""
        return self.columns.state[0][0].startswith("cube.")

    def model(self) -> mujoco.MjModel:
        """Return the authors' physics, compiled anew."""
        return mujoco.MjModel.from_xml_path(str(MODELS / self.model_file))

    def model_to_fit(self) -> mujoco.MjModel:
        """Return the physics whose parameters are fitted, compiled anew."""
        return mujoco.MjModel.from_xml_path(str(MODELS / (self.own_model_file or self.model_file)))


CASES = (
    Case(
        "triple pendulum",
        "triple_pendulum.xml",
        hinge_columns(3, ()),
        DT,
        partial(read_swing, "Triple"),
    ),
    Case(
        "triple pendulum, every fifth piece",
        "triple_pendulum.xml",
        hinge_columns(3, ()),
        DT,
        partial(read_swing_by_fifths, "Triple"),
    ),
    Case(
        "double pendulum",
        "double_pendulum.xml",
        hinge_columns(2, ()),
        DT,
        partial(read_swing, "Double"),
    ),
    Case(
        "double pendulum, every fifth piece",
        "double_pendulum.xml",
        hinge_columns(2, ()),
        DT,
        partial(read_swing_by_fifths, "Double"),
    ),
    Case("robot, excitation", "robot.xml", hinge_columns(2, TORQUES), DT, read_excitation),
    Case("robot, pendubot", "robot.xml", hinge_columns(2, TORQUES), DT, read_pendubot),
    Case(
        "cube tosses",
        "cube.xml",
        cube_tosses.columns(),
        cube_tosses.DT,
        cube_tosses.read_tosses,
        own_model_file="rounded_cube.xml",
    ),
)


@dataclass(frozen=True)
class Windows:
    """Pieces of recorded motion that begin with a measured state."""

    states: Float[np.ndarray, "W T+1 S"]
    """What was recorded; NaN behind the end of a toss."""
    controls: Float[np.ndarray, "W T C"]
    halves: Float[np.ndarray, "2 W S"] | None
    """The starts from one half of the samples and from the other, if they are known."""

    @property
    def starts(self) -> Float[np.ndarray, "W S"]:
        """The states every method begins with."""
        return self.states[:, 0]


def windows(case: Case, runs: list[Run], spacing: float = SPACING) -> Windows:
    """Return the windows of runs: whole tosses, or a second of a pendulum's motion every `spacing` [s]."""
    if case.is_cube:
        return _whole_runs(runs)
    length = round(WINDOW / case.dt)
    every = round(spacing / case.dt)
    states = []
    controls = []
    halves = []
    for run in runs:
        for start in range(0, len(run.states) - length, every):
            states.append(run.states[start : start + length + 1])
            controls.append(run.controls[start : start + length])
            if run.halves is not None:
                # The halves may end a sample early, never before the last start.
                halves.append(run.halves[:, start])
    both = np.stack(halves, axis=1) if halves else None
    return Windows(np.stack(states), np.stack(controls), both)


def _whole_runs(runs: list[Run]) -> Windows:
    length = max(len(run.states) for run in runs)
    states = np.full((len(runs), length, runs[0].states.shape[1]), np.nan)
    for number, run in enumerate(runs):
        states[number, : len(run.states)] = run.states
    controls = np.zeros((len(runs), length - 1, runs[0].controls.shape[1]))
    return Windows(states, controls, None)
