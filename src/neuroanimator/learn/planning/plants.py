"""Receding-horizon control: plan again at every super step from the measured state, and apply only the first control."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import DivergedError
from neuroanimator.learn.planning.planner import Plan, Planner, moved_on
from neuroanimator.systems.system import System

if (
    TYPE_CHECKING
):  # identification takes a third of a second to import, which most motions do without
    from neuroanimator.learn.planning.estimator import ParameterEstimator

Plant = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A plant: (state (S,), control (C,)) → the state one super step later."""
Disturbance = Callable[[int, np.ndarray], np.ndarray]
"""(super step, state (S,)) → the state after a push; the controller learns of it by measuring."""


@dataclass(frozen=True)
class EmulatorPlant:
    """The emulator as the plant."""

    emulator: Emulator

    def __call__(self, state: np.ndarray, control: np.ndarray) -> np.ndarray:
        """Return the state (S,) one super step later."""
        return np.asarray(self.emulator.rollout(state, control[None])[1], float)


@dataclass(frozen=True)
class PhysicsPlant:
    """The true physics as the plant."""

    system: System
    dt: float
    """Super step [s]."""

    def __call__(self, state: np.ndarray, control: np.ndarray) -> np.ndarray:
        """Return the state (S,) one super step later."""
        runs = self.system.simulate_fastest(state[None], control[None, None], self.dt)
        if runs.has_diverged[0]:
            raise DivergedError(
                "The physics diverged under control. Push less, or raise effort_weight."
            )
        return runs.states[0, 1]


@dataclass(frozen=True)
class ControlledMotion:
    """A closed-loop motion of a planner and a plant."""

    states: np.ndarray
    """Measured states (N+1, S), pushes included, and the last."""
    controls: np.ndarray
    """Controls (N, C), the first of each plan."""
    plan_seconds: np.ndarray
    """Time (P,) of each plan [s]."""

    @property
    def p99_ms(self) -> float:
        """99th percentile of the time of a plan [ms]."""
        return float(np.percentile(self.plan_seconds, 99) * 1e3)

    def followed_by(self, other: ControlledMotion) -> ControlledMotion:
        """Return this motion and `other`, which begins where it ends."""
        return ControlledMotion(
            np.concatenate([self.states[:-1], other.states]),
            np.concatenate([self.controls, other.controls]),
            np.concatenate([self.plan_seconds, other.plan_seconds]),
        )


def drive(
    plant: Plant,
    start: np.ndarray,
    control_of: Callable[[int, np.ndarray], np.ndarray],
    steps: int,
    disturb: Disturbance | None = None,
    *,
    on_step: Callable[[int], None] = lambda step: None,
) -> ControlledMotion:
    """Return the motion of `plant` from `start` (S,) under `control_of(super step, state)`, without planning."""
    state = start
    states = []
    controls = []
    for step in range(steps):
        if disturb is not None:
            state = disturb(step, state)
        states.append(state)
        controls.append(control_of(step, state))
        state = plant(state, controls[-1])
        on_step(step + 1)
    return ControlledMotion(np.stack([*states, state]), np.stack(controls), np.empty(0))


def control_plant(
    planner: Planner,
    plant: Plant,
    start: np.ndarray,
    steps: int,
    disturb: Disturbance | None = None,
    *,
    estimator: ParameterEstimator | None = None,
    on_step: Callable[[int], None] = lambda step: None,
) -> ControlledMotion:
    """Return the motion of `plant` from `start` (S,), replanned at each of `steps` super steps.

    A control acts from the state it was planned from: planning is assumed to be fast compared with a super step.
    Plans use the parameters in the plant's states, or with an `estimator` its estimates instead.
    `on_step` is called after each super step.
    """
    plans: list[Plan] = []

    def first_control(step: int, state: np.ndarray) -> np.ndarray:
        believed = state if estimator is None else estimator.believed(state)
        first = moved_on(plans[-1].controls) if plans else None
        plans.append(planner.plan(believed, first))
        return plans[-1].controls[0]

    def observed(state: np.ndarray, control: np.ndarray) -> np.ndarray:
        following = plant(state, control)
        if estimator is not None:
            estimator.observe(state, control, following)
        return following

    begin = planner.emulator.state.check(start, "state")
    motion = drive(observed, begin, first_control, steps, disturb, on_step=on_step)
    return replace(motion, plan_seconds=np.array([plan.seconds for plan in plans]))
