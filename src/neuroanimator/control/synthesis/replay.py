"""Replay controls on the true physics, beside what the emulator makes of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.objective import Objective, objective_cost
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase


@dataclass(frozen=True)
class Replay:
    """The same controls on the emulator and on the physics."""

    emulator_states: np.ndarray
    """(T+1, S)"""
    physics_states: np.ndarray
    """(T+1, S) by the system's truth."""
    cost_emulator: float
    cost_physics: float

    @property
    def gap(self) -> float:
        """How much dearer the motion is on the physics."""
        return self.cost_physics - self.cost_emulator


def replay(
    emulator: Emulator,
    system: System,
    objective: Objective,
    start: ArrayLike,
    controls: Float[np.ndarray, "T C"],
) -> Replay:
    """Return what `controls` (T, C) do from `start` (S,) on emulator and physics.

    Raises NeuroAnimatorError where the physics blows up.
    """
    motion = ranked_on_physics(emulator, system, objective, start, controls[None])[0]
    return beside_emulated(emulator, objective, motion)


class Motion(NamedTuple):
    """What controls do on the true physics."""

    controls: np.ndarray
    """(T, C)"""
    states: np.ndarray
    """(T+1, S)"""
    cost: float
    """J"""


def beside_emulated(emulator: Emulator, objective: Objective, motion: Motion) -> Replay:
    """Return the physics' `motion` with the emulator's under the same controls from the same start."""
    with phase("emulating"):
        emulator_states = np.asarray(emulator.rollout(motion.states[0], motion.controls))
    cost = objective_cost(objective, emulator, emulator_states, motion.controls)
    return Replay(emulator_states, motion.states, cost, motion.cost)


def ranked_on_physics(
    emulator: Emulator,
    system: System,
    objective: Objective,
    start: ArrayLike,
    candidates: Float[np.ndarray, "K T C"],
) -> list[Motion]:
    """Return what `candidates` do from `start` (S,) on the true physics, the least J first; those that diverge are left out."""
    starts = np.broadcast_to(np.asarray(start, float), (len(candidates), system.state.size))
    with phase("replaying"):
        runs = system.simulate_fastest(starts, candidates, emulator.dt)
    if runs.has_diverged.all():
        raise NeuroAnimatorError(
            "The physics diverged under these controls. Raise effort_weight, or shorten the motion."
        )
    motions = []
    for number in np.flatnonzero(~runs.has_diverged):
        controls = candidates[number]
        states = runs.states[number]
        cost = objective_cost(objective, emulator, states, controls)
        motions.append(Motion(controls, states, cost))
    return sorted(motions, key=lambda motion: motion.cost)
