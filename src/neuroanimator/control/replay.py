"""Play controllers on the true physics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroanimator.control.objective import Objective, objective_cost
from neuroanimator.control.physics import play
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.systems.system import System


@dataclass(frozen=True)
class Replay:
    """The same controls on the emulator and on the physics."""

    emulated: np.ndarray
    """(T+1, S)"""
    physical: np.ndarray
    """(T+1, S) by the system's truth."""
    cost_emulator: float
    cost_physics: float

    @property
    def gap(self) -> float:
        """How much dearer the motion is on the physics."""
        return self.cost_physics - self.cost_emulator


def replay(emulator: Emulator, system: System, objective: Objective, start: np.ndarray, controls: np.ndarray) -> Replay:
    """Return what `controls` (T, C) do from `start` (S,) on both."""
    physical, cost = best_on_physics(emulator, system, objective, start, controls[None])[1:]
    emulated = np.asarray(emulator.rollout(start, controls))
    return Replay(emulated, physical, objective_cost(objective, emulator, emulated, controls), cost)


def best_on_physics(
    emulator: Emulator, system: System, objective: Objective, start: np.ndarray, candidates: np.ndarray
) -> tuple[int, np.ndarray, float]:
    """Return which of the controls (K, T, C) costs least on the true physics, its states (T+1, S), and its J."""
    starts = np.broadcast_to(start, (len(candidates), len(start)))
    runs = play(system, starts, candidates, emulator.dt)
    if not runs.is_alive.any():
        raise NeuroAnimatorError(
            "The physics blew up under these controls. Raise effort_weight, or shorten the motion."
        )
    costs = [
        objective_cost(objective, emulator, states, controls) if is_alive else np.inf
        for states, controls, is_alive in zip(runs.states, candidates, runs.is_alive, strict=True)
    ]
    best = int(np.argmin(costs))
    return best, runs.states[best], costs[best]
