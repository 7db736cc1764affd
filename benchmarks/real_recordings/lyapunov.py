"""The Lyapunov time of a pendulum's physics at the energies it was recorded at."""

from __future__ import annotations

import mujoco
import numpy as np

from benchmarks.real_recordings.cases import Case, Windows
from benchmarks.real_recordings.physics import simulate

STARTS = 10
"""Number of recorded states the physics begins at."""

SECONDS = 100.0
"""Time over which neighbouring motions are followed [s]."""

INTERVAL = 0.1
"""The distance of neighbours is measured and made small again after so long [s]."""

STEP = 0.0025
"""Step of the physics [s]."""

DISTANCE = 1e-7
"""Their distance at the beginning of each interval [rad, rad/s]."""

SLOWEST = 0.1
"""Below this exponent motion counts as regular [1/s]: neighbours that part in proportion to time seem to have one of
some hundredths after so long."""


def lyapunov_time(case: Case, unseen: Windows) -> float | str:
    """Return the mean time [s] in which neighbouring motions part by a factor e; "regular" if they do not.

    The motions are those of the authors' model without friction and without drive, so that they keep the energy of the
    recorded states they begin at (Benettin's method: one neighbour, brought near again after every interval).
    """
    model = case.model()
    model.dof_damping[:] = 0
    model.dof_frictionloss[:] = 0
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    rows = np.linspace(0, len(unseen.starts) - 1, STARTS).astype(int)
    model.opt.timestep = STEP
    states = unseen.starts[rows]
    rng = np.random.default_rng(0)
    direction = rng.normal(size=states.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    idle = np.zeros((2 * STARTS, round(INTERVAL / case.dt), 0))
    intervals = round(SECONDS / INTERVAL)
    growth = 0.0
    for _ in range(intervals):
        both = np.concatenate([states, states + DISTANCE * direction])
        ends = simulate(model, both, idle, case.dt)[:, -1]
        states = ends[:STARTS]
        difference = ends[STARTS:] - states
        distance = np.linalg.norm(difference, axis=1, keepdims=True)
        growth += float(np.mean(np.log(distance / DISTANCE)))
        direction = difference / distance
    exponent = growth / SECONDS
    if exponent < SLOWEST:
        return "regular"
    return 1 / exponent
