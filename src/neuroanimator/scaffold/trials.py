"""Trial runs of a drafted definition: positions and velocities of its joints, and their cost."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.learn.data.config import RUN_STEPS
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.physics.rigid.joints import JointView
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.physics.rigid.warnings import warnings_heard
from neuroanimator.scaffold.defaults import FASTEST, rounded
from neuroanimator.state.rotation import rotate_back
from neuroanimator.systems.random_controls import sample_control_runs

TRIAL_RUNS = 16
"""Maximum number of trial runs; each starts elsewhere, and lasts as long as a run of a dataset."""

MIN_RUNS = 6
"""Minimum number of trial runs, however slow the model is."""

TRIAL_SECONDS = 1.5
"""Approximate time of trial runs on one core [s], which sets their number."""

USUAL_CONTACTS = 4.0
"""Typical number of contacts at a time in a model with contacts."""

EVALUATIONS = {"rk4": 4}
"""Number of force evaluations in a step of an integrator; one for any other."""

STIFF_INTEGRATORS = ("implicitfast", "discrete")
"""Integrators tried where the wanted one diverges: one for stiff damping, one for stiff springs, too."""

TRIAL_SEED = 0
"""Seed of trial runs, so that a proposal is the same every time."""

OUTER = 1
"""Percentile of positions left out as outliers, at either end."""

ROOM = 0.1
"""Share by which the observed range is widened to either side: trial runs are few."""


class ModelTrial(NamedTuple):
    """Trial runs as `generate` would make them, without those that diverged."""

    states: Float[np.ndarray, "B T+1 S"]
    """States: the start, and the state after each control."""
    controls: Float[np.ndarray, "B T C"]
    """Controls: row k is held from state k to state k+1."""
    dt: float
    """Time one super step covers [s]."""
    diverged: int
    """Number of runs that diverged."""
    warnings: Counter[str]
    """MuJoCo's warnings in them."""

    @property
    def runs(self) -> int:
        """Number of all runs."""
        return len(self.states) + self.diverged


def run_trial(system: ModelSystem, substeps: int) -> ModelTrial:
    """Return trial runs by the model's own scheme, in super steps of `substeps`."""
    rng = np.random.default_rng(TRIAL_SEED)
    dt = substeps * system.physics_dt
    contacts = USUAL_CONTACTS if system.warm_up else 0.0
    cost = step_cost(system, contacts) * EVALUATIONS.get(system.scheme.integrator, 1)
    seconds = (system.warm_up + RUN_STEPS * dt) / system.physics_dt * cost
    count = int(np.clip(TRIAL_SECONDS / seconds, MIN_RUNS, TRIAL_RUNS))
    before = warnings_heard()
    starts = sample_starts(system, rng, count)
    controls = sample_control_runs(rng, count, RUN_STEPS, dt, system)
    runs = system.simulate_fastest(starts, controls, dt, scheme=system.scheme)
    is_whole = ~runs.has_diverged
    heard = warnings_heard() - before
    return ModelTrial(
        runs.states[is_whole], controls[is_whole], dt, int(runs.has_diverged.sum()), heard
    )


def step_cost(system: ModelSystem, contacts: float) -> float:
    """Return the approximate time of MuJoCo on one core for the forces of one step [s], the same on every machine.

    It fits Gymnasium's models, including the humanoid, within a factor of two. It decides what is tried, so it must not
    depend on a machine's load. `contacts` is their usual number.
    """
    freedoms = system.model.nv
    return (1.5 + 0.5 * freedoms + 0.01 * freedoms**2 + 2.0 * contacts) * 1e-6


def velocities_of(view: JointView, states: Float[np.ndarray, "*B S"]) -> Float[np.ndarray, "*B V"]:
    """Return the velocities of a joint."""
    return states[..., list(view.velocities)]


def usual_velocities(
    system: ModelSystem, states: Float[np.ndarray, "*B S"]
) -> dict[str, tuple[float, ...]]:
    """Return the rms velocities of each joint, a root's along its own axes: random starts should be as fast as in use."""
    usual = {}
    for view in system.views:
        velocities = velocities_of(view, states).copy()
        if view.kind == "free":
            orientation = states[..., view.position_entry + 3 : view.position_entry + 7]
            velocities[..., :3] = rotate_back(orientation, velocities[..., :3])
        rms = np.sqrt(np.mean(velocities.reshape(-1, velocities.shape[-1]) ** 2, axis=0))
        usual[view.name] = tuple(rounded(value, 2) for value in rms)
    return usual


def occurring_range(
    trial: ModelTrial, entry: int, limits: tuple[float, float]
) -> tuple[float, float]:
    """Return the observed range of a state entry, slightly widened and within `limits`."""
    low, high = np.percentile(trial.states[..., entry], [OUTER, 100 - OUTER])
    room = ROOM * (high - low)
    low = max(low - room, limits[0])
    high = min(high + room, limits[1])
    return round(float(low), 4), round(float(max(low, high)), 4)


def fastest_turning(system: ModelSystem, trial: ModelTrial) -> tuple[str, float]:
    """Return (name of the joint that turns fastest, its speed [rad/s]); an empty name and 0 if none turns."""
    name = ""
    fastest = 0.0
    for view in system.views:
        if view.kind == "slide":
            continue
        turning = velocities_of(view, trial.states)[..., -3:]  # a free root's come last
        speed = float(np.percentile(np.linalg.norm(turning, axis=-1), FASTEST))
        if speed > fastest:
            name = view.name
            fastest = speed
    return name, fastest
