"""Receding-horizon control: plan again at every super step from the measured state, and apply only the first control."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from neuroanimator.learn.planning.planner import Plan, Planner, moved_on
from neuroanimator.systems.plants import Plant

if (
    TYPE_CHECKING
):  # identification takes a third of a second to import, which most motions do without
    from neuroanimator.learn.planning.estimator import ParameterEstimator

Disturbance = Callable[[int, np.ndarray], np.ndarray]
"""(super step, state (S,)) → the state after a push; the controller learns of it by measuring."""


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


class Replanning:
    """A controller that plans anew at every super step; the search begins with the last plan, moved on."""

    def __init__(self, planner: Planner):
        self.planner = planner
        self.plans: list[Plan] = []

    def __call__(self, state: np.ndarray) -> np.ndarray:
        """Return the first control (C,) of the plan from `state` (S,)."""
        first = moved_on(self.plans[-1].controls) if self.plans else None
        self.plans.append(self.planner.plan(state, first))
        return self.plans[-1].controls[0]

    def timed(self, motion: ControlledMotion) -> ControlledMotion:
        """Return the motion that was planned, with the times of its plans."""
        return replace(motion, plan_seconds=np.array([plan.seconds for plan in self.plans]))


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
    replanning = Replanning(planner)

    def first_control(step: int, state: np.ndarray) -> np.ndarray:
        return replanning(state if estimator is None else estimator.believed(state))

    def observed(state: np.ndarray, control: np.ndarray) -> np.ndarray:
        following = plant(state, control)
        if estimator is not None:
            estimator.observe(state, control, following)
        return following

    begin = planner.emulator.state.check(start, "state")
    motion = drive(observed, begin, first_control, steps, disturb, on_step=on_step)
    return replanning.timed(motion)
