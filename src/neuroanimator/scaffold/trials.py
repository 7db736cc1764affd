"""Trial runs of a drafted definition: how far its joints go, how fast they turn, what that says of the super step."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.data.config import RUN_STEPS
from neuroanimator.data.sampling import sample_control_runs, sample_starts
from neuroanimator.scaffold.defaults import FASTEST
from neuroanimator.scaffold.holding import at
from neuroanimator.scaffold.surroundings import has_contacts
from neuroanimator.state.rotation import rotate_back
from neuroanimator.systems.rigid.joints import JointView
from neuroanimator.systems.rigid.model_system import RATE_SIZES, ModelSystem
from neuroanimator.systems.rigid.warnings import warnings_counted

TRIAL_RUNS = 16
"""At most this many trial runs show what a model does; each starts elsewhere, and lasts as long as a run of a dataset."""

MIN_RUNS = 6
"""But never fewer than this, however dear the model is."""

TRIAL_SECONDS = 1.5
"""Time [s] that trial runs take on one core, about: it sets their number."""

USUAL_CONTACTS = 4.0
"""A model with contacts has about this many at a time."""

EVALUATIONS = {"rk4": 4}
"""Number of force evaluations in a step of an integrator; of any other, one."""

TRIAL_SEED = 0
"""Trial runs are drawn with this seed, so that a proposal is the same every time."""

OUTER = 1
"""Positions below this percentile, and above its counterpart, are left out of what occurs."""

ROOM = 0.1
"""The range that occurred is widened by this share to either side: trial runs are few."""

MAX_GROWTH = 0.5
"""A fall from rest grows at most by e to this in a super step: else control comes too late, and errors grow as fast."""

NUDGE = 1e-6
"""The model at rest is linearised with differences of this size."""


class Trial(NamedTuple):
    """Trial runs as `generate` would make them; those that diverged are left out."""

    states: Float[np.ndarray, "B T+1 S"]
    """The start, and the state after each control."""
    controls: Float[np.ndarray, "B T C"]
    """Row k is held from state k to state k+1."""
    dt: float
    """Time one super step covers [s]."""
    diverged: int
    """This many runs diverged."""

    @property
    def runs(self) -> int:
        """How many runs were tried."""
        return len(self.states) + self.diverged

    @property
    def explodes(self) -> bool:
        """Whether half the runs diverged, or more."""
        return 2 * self.diverged >= self.runs


def run_trial(system: ModelSystem, substeps: int) -> Trial:
    """Return trial runs by the model's own scheme, in super steps of `substeps`."""
    rng = np.random.default_rng(TRIAL_SEED)
    dt = substeps * system.physics_dt
    count = _affordable_runs(system, dt)
    starts = sample_starts(system, rng, count)
    controls = sample_control_runs(rng, count, RUN_STEPS, dt, system)
    runs = system.simulate_fastest(starts, controls, dt, scheme=system.scheme)
    is_whole = ~runs.has_diverged
    return Trial(runs.states[is_whole], controls[is_whole], dt, int(runs.has_diverged.sum()))


def _affordable_runs(system: ModelSystem, dt: float) -> int:
    """Return how many trial runs take about `TRIAL_SECONDS` by `step_cost`."""
    duration = system.warm_up + RUN_STEPS * dt
    evaluations = duration / system.physics_dt * EVALUATIONS.get(system.scheme.integrator, 1)
    contacts = USUAL_CONTACTS if system.warm_up else 0.0
    return int(
        np.clip(TRIAL_SECONDS / (evaluations * step_cost(system, contacts)), MIN_RUNS, TRIAL_RUNS)
    )


def step_cost(system: ModelSystem, contacts: float) -> float:
    """Return about how long MuJoCo takes on one core for the forces of one step [s], the same on every machine.

    It is fitted to Gymnasium's models, the humanoid among them, to within a factor of two: it decides what is tried,
    so it must not depend on what else a machine does. `contacts` is how many there usually are.
    """
    freedoms = system.model.nv
    return (1.5 + 0.5 * freedoms + 0.01 * freedoms**2 + 2.0 * contacts) * 1e-6


def velocity_size(view: JointView) -> int:
    """Return how many numbers the velocity of a joint has."""
    return RATE_SIZES.get(view.kind, 1)


def usual_velocities(system: ModelSystem, trial: Trial) -> dict[str, tuple[float, ...]]:
    """Return per joint the rms of its velocities: random starts should be as fast as use is; a root's along its own axes."""
    velocities = {}
    for view in system.views:
        first = view.velocity_entry
        found = trial.states[..., first : first + velocity_size(view)].copy()
        if view.kind == "free":
            orientation = trial.states[..., view.position_entry + 3 : view.position_entry + 7]
            found[..., :3] = rotate_back(orientation, found[..., :3])
        rms = np.sqrt(np.mean(found**2, axis=(0, 1)))
        velocities[view.name] = tuple(two_digits(value) for value in rms)
    return velocities


def occurring_range(trial: Trial, entry: int, limits: tuple[float, float]) -> tuple[float, float]:
    """Return from where to where a state entry goes, a little widened and within `limits`."""
    low, high = np.percentile(trial.states[..., entry], [OUTER, 100 - OUTER])
    room = ROOM * (high - low)
    low = max(low - room, limits[0])
    high = min(high + room, limits[1])
    return round(float(low), 4), round(float(max(low, high)), 4)


def fastest_turning(system: ModelSystem, trial: Trial) -> tuple[str, float]:
    """Return (the joint that turns fastest, how fast that is [rad/s]); nothing and 0 if none turns."""
    name = ""
    fastest = 0.0
    for view in system.views:
        if view.kind == "slide":
            continue
        end = view.velocity_entry + velocity_size(view)
        first = max(view.velocity_entry, end - 3)  # a free root's angular velocity comes last
        speeds = np.linalg.norm(trial.states[..., first:end], axis=-1)
        speed = float(np.percentile(speeds, FASTEST))
        if speed > fastest:
            name = view.name
            fastest = speed
    return name, fastest


def growth_at_rest(
    model: mujoco.MjModel, rest: Float[np.ndarray, " P"], controls: Float[np.ndarray, " C"]
) -> float:
    """Return the rate at which the fastest fall from `rest` under `controls` grows [1/s]; 0 if none does.

    It is the largest real part of the linearised model's eigenvalues. Of a model that can touch something it is taken
    for 0: what just touches at rest would look as if it were thrown off.
    """
    if has_contacts(model):
        return 0.0
    implicit = model.__copy__()
    implicit.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    with warnings_counted:
        data = at(implicit, rest, controls)
        if data.nefc:
            return 0.0
        size = 2 * model.nv + model.na
        transition = np.zeros((size, size))
        mujoco.mjd_transitionFD(implicit, data, NUDGE, True, transition, None, None, None)
    if not np.isfinite(transition).all():
        return 0.0
    largest = float(np.abs(np.linalg.eigvals(transition)).max())
    return max(0.0, float(np.log(max(largest, 1e-300))) / model.opt.timestep)


def two_digits(value: float) -> float:
    """Return a number rounded to two significant digits, for people to read."""
    return float(f"{value:.2g}")
