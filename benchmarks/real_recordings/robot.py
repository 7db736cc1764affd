"""The real double pendulum with two motors of dfki-ric-underactuated-lab/double_pendulum (design C.1).

Two cases:

* excitation: both motors follow sines, 10 s each. Six runs are training; unseen are two of other frequencies and the two
  swing-ups, which go on to the upright (they are nearly the same motion, so neither may be in training).
* pendubot: swing-ups and balance, driven by the shoulder's motor. Training are the ten runs of one controller (iLQR with
  time-varying LQR), unseen the ten of another (soft actor-critic with LQR).

The authors' sampling varies around 2 and 2.5 ms (up to 19 ms in one run): angles are interpolated at 1 kHz, smoothed, and
kept at 200 Hz. A control is the mean, over a sample's 5 ms, of the torque the motors report from their current; the authors
fitted their model to that torque, too. Angles are those of hinges, zero when hanging.

Five of the fifteen excitation runs are files of more than 4 MB and are not used.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.real_recordings.runs import DT, Run, half_states, sampled_states
from benchmarks.real_recordings.source_files import ROBOT, SourceFile, source_files

WIDTH = 0.05
"""Velocities are slopes over so long [s]: an encoder's step is 0.0004 rad."""

SHORTEST = 1e-6
"""No mean is taken over less than this [s]."""

EXCITATION = "data/experiment_records/design_C.1/sys_id/20230629/"
PENDUBOT = "leaderboard/pendubot/real_hardware_v2/src_data/"

UNSEEN_EXCITATION = (
    "20230629-143524",
    "20230629-143747",
    "20230629-154220",
    "20230629-154548",
)
"""Runs that are not in training."""


def read_excitation(data: Path) -> tuple[list[Run], list[Run]]:
    """Return (the training part, the unseen part) of the runs in which both motors follow sines."""
    training = []
    unseen = []
    for file in source_files(ROBOT, EXCITATION):
        run = _run(file, data)
        if run.name in UNSEEN_EXCITATION:
            unseen.append(run)
        else:
            training.append(run)
    return training, unseen


def read_pendubot(data: Path) -> tuple[list[Run], list[Run]]:
    """Return (the runs of one controller, the runs of another)."""
    training = [_run(file, data) for file in source_files(ROBOT, PENDUBOT + "ilqr_tvlqr_lqr/")]
    unseen = [_run(file, data) for file in source_files(ROBOT, PENDUBOT + "sac_lqr/")]
    return training, unseen


def _run(file: SourceFile, data: Path) -> Run:
    table = np.genfromtxt(io.BytesIO(file.read(data)), delimiter=",", names=True)
    time = table["time"]
    angles = np.stack([table["pos_meas1"], table["pos_meas2"]], axis=1)
    states = sampled_states(time, angles, WIDTH)
    starts = time[0] + DT * np.arange(len(states))
    torques = [_mean_control(time, table[f"tau_meas{hinge}"], starts) for hinge in "12"]
    name = Path(file.path).parent.name
    return Run(name, states, np.stack(torques, axis=1), half_states(time, angles, WIDTH))


def _mean_control(
    time: Float[np.ndarray, " N"], values: Float[np.ndarray, " N"], starts: Float[np.ndarray, " T"]
) -> Float[np.ndarray, " T"]:
    """Return the mean over DT from each start on of what holds its value until the next sample."""
    held = np.append(0.0, np.cumsum(values[:-1] * np.diff(time)))
    ends = np.minimum(starts + DT, time[-1])
    area = np.interp(ends, time, held) - np.interp(starts, time, held)
    return area / np.maximum(ends - starts, SHORTEST)
