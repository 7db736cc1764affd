"""Play a controller on the true physics."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from neuroanimator.control.objective import Objective
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
    runs = system.simulate(start[None], controls[None], emulator.dt)
    if not runs.is_alive[0]:
        raise NeuroAnimatorError(
            "The physics blew up under these controls. Raise effort_weight, or shorten the motion."
        )
    emulated = np.asarray(emulator.rollout(start, controls))
    limit = jnp.asarray(system.bounds.largest)
    costs = [
        float(objective(jnp.asarray(path), jnp.asarray(controls), limit, emulator.dt))
        for path in (emulated, runs.states[0])
    ]
    return Replay(emulated, runs.states[0], *costs)


UPRIGHT_WITHIN = np.deg2rad(10.0)
"""[rad] Each link may lean this much and still count as upright."""
STILL_WITHIN = 1.0
"""[rad/s] Each link may turn this fast and still count as still."""


def is_upright(state: np.ndarray) -> bool:
    """Return whether all three links of the pendulum in `state` (6,) point up and are nearly still."""
    lean = np.cumsum(state[:3]) - np.pi
    lean = (lean + np.pi) % (2 * np.pi) - np.pi
    return bool((np.abs(lean) < UPRIGHT_WITHIN).all() and (np.abs(np.cumsum(state[3:])) < STILL_WITHIN).all())
