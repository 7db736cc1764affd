"""The runs an emulator is tested on, which training never saw: simulated finely, or recorded and kept apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.normaliser import MIN_CHANGE
from neuroanimator.emulator.spec import GAINS, EmulatorSpec
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.learn.data.config import RUN_STEPS
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.data.store import Dataset
from neuroanimator.learn.data.stored import SuperSteps
from neuroanimator.learn.training.validation import usual_change
from neuroanimator.physics import carried_system
from neuroanimator.state.arrays import as_rows
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.slowness import slowness
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import Scheme, System
from neuroanimator.terminal import warn_once
from neuroanimator.text import quoted

HELD_OUT_SEED = 2**31
"""Seed of test runs, one above the largest a dataset may have."""

HELD_OUT_SECONDS = 5.0
"""Length of a test run [s], the longest horizon reported."""

HELD_OUT_RUNS = 32
"""Default number of runs in a test."""

MAX_TRANSITIONS = 1_600
"""Maximum number of super steps on which one-step errors are measured; the physics takes each by every scheme."""

SAME_TIME = 1e-9
"""Difference below which two super steps are the same [s]."""


@dataclass(frozen=True)
class HeldOut:
    """Unseen runs and their motions by fine physics."""

    system: System
    dt: float
    states: Float[np.ndarray, "B _ S"]
    """States (B, T+1, S) by the system's `fine` scheme."""
    controls: Float[np.ndarray, "B T C"]
    change_scale: Float[np.ndarray, " V"]
    """Standard deviation of the change in one super step, in the body's own frame: the unit of every error.

    Zero for a number whose change is always the same, which has no error: see `moves`.
    """
    most_transitions: int = MAX_TRANSITIONS
    noise: Float[np.ndarray, " S"] | None = None
    """Standard deviation of the noise in the states, where they were recorded and it is known."""

    @property
    def frame(self) -> Frame:
        """The frame in which states are compared."""
        return Frame.of(self.system.structure, self.dt)

    @property
    def moves(self) -> Bool[np.ndarray, " V"]:
        """Whether each number of a change varies at all: a target at rest has no meaningful error."""
        return self.change_scale >= MIN_CHANGE

    def relative(self, errors: Float[np.ndarray, "*B V"]) -> Float[np.ndarray, "*B M"]:
        """Return the errors of what moves, over the standard deviation of its change."""
        return errors[..., self.moves] / self.change_scale[self.moves]

    @property
    def still(self) -> list[str]:
        """Names and units of the state entries whose change never varies, and which are left out of every error."""
        names = self.system.state.names
        entries = self.frame.change_entries(self.states.shape[-1])
        still = []
        for name, numbers in zip(names, entries, strict=True):
            if numbers and not self.moves[list(numbers)].any():
                still.append(name)
        return still

    @property
    def transitions(self) -> SuperSteps:
        """At most `most_transitions` super steps, taken evenly from all runs.

        They come from the first `RUN_STEPS` super steps, as the examples of a dataset do.
        """
        span = min(RUN_STEPS, self.controls.shape[1])
        every = -(-len(self.controls) * span // self.most_transitions)
        return SuperSteps(
            states=as_rows(self.states[:, :span])[::every],
            controls=as_rows(self.controls[:, :span])[::every],
            next_states=as_rows(self.states[:, 1 : span + 1])[::every],
        )

    def moments(self, count: int) -> tuple[Float[np.ndarray, "N S"], Float[np.ndarray, "N C"]]:
        """Return the states at `count` random moments of the runs, and their controls.

        They are the same at every call, so that all physics is timed on the same ones.
        """
        rng = np.random.default_rng(0)
        runs = rng.integers(0, len(self.states), count)
        steps = rng.integers(0, self.controls.shape[1], count)
        return self.states[runs, steps], self.controls[runs, steps]


GAIN_TOLERANCE = 1e-3
"""Relative difference of an actuator's gain that counts as rounding."""


def system_of(emulator: Emulator) -> System:
    """Return the physics `emulator` stands for; BadFileError if that has another state or control."""
    spec = emulator.spec
    system = carried_system(spec.system, spec.definition)
    if not system.fits(spec):
        raise BadFileError(
            f"The emulator names the system {system.name}, whose state or control differs."
        )
    _tell_other_gains(system, spec)
    return system


def _tell_other_gains(system: System, spec: EmulatorSpec) -> None:
    """Warn of physics whose actuators another release of MuJoCo compiles with other gains than were trained under."""
    from neuroanimator.physics.rigid.actuators import actuator_name
    from neuroanimator.physics.rigid.mujoco_system import MujocoSystem

    now = system.engine
    before = spec.engine
    if now is None or before is None or len(now.gains) != len(before.gains):
        return
    pairs = enumerate(zip(before.gains, now.gains, strict=True))
    other = [place for place, gains in pairs if not np.isclose(*gains, rtol=GAIN_TOLERANCE)]
    if other and isinstance(system, MujocoSystem):
        actuator, what = divmod(other[0], len(GAINS))
        name = actuator_name(system.model, actuator)
        warn_once(
            f"{spec.system}: the {GAINS[what]} of the actuator {quoted(name)} is {now.gains[other[0]]:.4g} by MuJoCo "
            f"{now.release}, and was {before.gains[other[0]]:.4g} by {before.release}, under which the emulator was trained, "
            "so the physics differs. Write it into the model as kp and kv, or train again."
        )


def replayable_system(emulator: Emulator) -> System:
    """Return the physics `emulator` stands for; where its model is missing, the system without physics.

    Raises BadFileError as `system_of` does.
    """
    from neuroanimator.physics.rigid.absent_model import AbsentModel
    from neuroanimator.systems.named_files import MissingPhysicsError

    try:
        return system_of(emulator)
    except MissingPhysicsError as error:
        return AbsentModel(emulator.spec, emulator.state_structure, str(error))


def held_out_runs(
    emulator: Emulator,
    count: int = HELD_OUT_RUNS,
    seconds: float | None = None,
    seed: int = 0,
    *,
    scheme: Scheme | None = None,
) -> HeldOut:
    """Return `count` unseen runs of the emulator's system under random, never idle controls, by its `fine` scheme or `scheme`.

    They last `HELD_OUT_SECONDS` by default, longer for a slow system.
    """
    rng = np.random.default_rng([HELD_OUT_SEED, seed])
    system = system_of(emulator)
    dt = emulator.dt
    if seconds is None:
        seconds = HELD_OUT_SECONDS * slowness(dt)
    steps = round(seconds / dt)
    threads = core_count()
    starts = sample_starts(system, rng, count, threads)
    controls = sample_control_runs(rng, count, steps, dt, system)
    runs = system.simulate(starts, controls, dt, scheme=scheme or system.fine, threads=threads)
    return make_test(system, dt, runs.states[~runs.has_diverged], controls[~runs.has_diverged])


def make_test(
    system: System,
    dt: float,
    states: Float[np.ndarray, "B _ S"],
    controls: Float[np.ndarray, "B T C"],
) -> HeldOut:
    """Return the runs (B, T+1, S) under controls (B, T, C) as a test; refuse runs in which nothing happens."""
    if not len(states):
        raise ArgumentError(
            f"{system.name}: every test run diverged in the physics itself. Use a smaller step."
        )
    test = HeldOut(system, dt, states, controls, usual_change(system.structure, states))
    if not test.moves.any():
        raise ArgumentError(
            f"{system.name}: nothing changes by {MIN_CHANGE:g} of its unit in a super step."
        )
    return test


def recorded_runs(emulator: Emulator, data: Dataset | None) -> HeldOut:
    """Return the runs of `data` that were kept for the test of an emulator of recordings."""
    spec = emulator.spec
    if data is None or data.held_out is None:
        raise ArgumentError(
            f"data: {spec.system} was learnt from recordings; the test needs those that 'generate' kept apart. "
            "Pass its folder: --data."
        )
    dt = data.config.substeps * data.system.physics_dt
    is_same_layout = (data.system.state, data.system.control) == (spec.state, spec.control)
    if not is_same_layout or abs(dt - spec.dt) > SAME_TIME:
        raise ArgumentError(
            f"data: other state, control or super step than the emulator's of {spec.system}."
        )
    states, controls = data.held_out
    return replace(make_test(data.system, spec.dt, states, controls), noise=data.noise)
