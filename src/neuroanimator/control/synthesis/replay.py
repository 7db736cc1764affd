"""Replay controls on the true physics, beside the emulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.objective_cost import objective_cost
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import DivergedError
from neuroanimator.systems.system import Runs, System
from neuroanimator.terminal import phase

LARGE_GAP = 0.5
"""Maximum small gap of J: half the cost of one number of the final state that is off by its scale."""

LARGE_GAP_SHARE = 0.25
"""Maximum small gap of J as a share of J on the physics."""

WRONG_FACTOR = 2.0
"""Ratio of the larger J to the smaller from which on the emulator is called wrong about a motion."""

WRONG_GAP = 4.0
"""Minimum difference of the two: the cost of a number of the final state that is off by twice its scale."""


def is_gap_large(cost_emulator: float, cost_physics: float) -> bool:
    """Return whether the physics disagrees with the emulator so much that more effort is worth the time."""
    return cost_physics - cost_emulator > max(LARGE_GAP, LARGE_GAP_SHARE * cost_physics)


@dataclass(frozen=True)
class Replay:
    """The same controls on the emulator and on the physics."""

    emulator_states: np.ndarray
    """States (T+1, S) on the emulator."""
    physics_states: np.ndarray
    """States (T+1, S) on the system's true physics; on the emulator, too, unless `is_on_physics`."""
    cost_emulator: float
    cost_physics: float
    is_on_physics: bool = True
    """Whether there was physics to replay on; without it, as for recordings, the emulator stands in, which proves nothing."""

    @property
    def gap(self) -> float:
        """J on the physics minus J on the emulator."""
        return self.cost_physics - self.cost_emulator

    @property
    def fault(self) -> str:
        """Sentence that the emulator is wrong about this motion, for better or worse; empty if it is not, or without physics."""
        least, most = sorted((self.cost_emulator, self.cost_physics))
        if not self.is_on_physics or most < max(WRONG_FACTOR * least, least + WRONG_GAP):
            return ""
        return (
            f"The emulator is wrong about the motion found, whatever its trust: J is {self.cost_physics:.3g} on the physics "
            f"and {self.cost_emulator:.3g} on the emulator"
        )


def replay(
    emulator: Emulator,
    system: System,
    objective: Objective,
    start: ArrayLike,
    controls: Float[np.ndarray, "T C"],
) -> Replay:
    """Return the motions of `controls` (T, C) from `start` (S,) on emulator and physics.

    Raises DivergedError if the physics diverges.
    """
    motion = ranked_motions(emulator, system, objective, start, controls[None])[0]
    return beside_emulated(emulator, system, objective, motion)


class ReplayedMotion(NamedTuple):
    """A motion on the true physics; on the emulator without physics, as for recordings."""

    controls: np.ndarray
    """Controls (T, C)."""
    states: np.ndarray
    """States (T+1, S)."""
    cost: float
    """J of the motion."""


def beside_emulated(
    emulator: Emulator, system: System, objective: Objective, motion: ReplayedMotion
) -> Replay:
    """Return the physics' `motion` and the emulator's under the same controls from the same start."""
    with phase("emulating"):
        emulator_states = np.asarray(emulator.rollout(motion.states[0], motion.controls))
    cost = objective_cost(objective, emulator, emulator_states, motion.controls)
    return Replay(emulator_states, motion.states, cost, motion.cost, system.can_simulate)


def ranked_motions(
    emulator: Emulator,
    system: System,
    objective: Objective,
    start: ArrayLike,
    candidates: Float[np.ndarray, "K T C"],
) -> list[ReplayedMotion]:
    """Return the motions of `candidates` from `start` (S,) on the true physics, the least J first, without diverged ones.

    Without physics, as for recordings, they are motions on the emulator. Raises DivergedError if all diverge.
    """
    starts = np.broadcast_to(np.asarray(start, float), (len(candidates), system.state.size))
    if system.can_simulate:
        with phase("replaying"):
            runs = system.simulate_fastest(starts, candidates, emulator.dt)
        judge = "physics"
    else:
        with phase("emulating"):
            states = np.asarray(emulator.rollout(starts, candidates, may_diverge=True), float)
        runs = Runs(states, np.asarray(~np.isfinite(states).all(axis=(1, 2))))
        judge = "emulator"
    if runs.has_diverged.all():
        raise DivergedError(
            f"The {judge} diverged under these controls. Raise effort_weight, or shorten the motion."
        )
    motions = []
    for number in np.flatnonzero(~runs.has_diverged):
        controls = candidates[number]
        states = runs.states[number]
        cost = objective_cost(objective, emulator, states, controls)
        motions.append(ReplayedMotion(controls, states, cost))
    return sorted(motions, key=lambda motion: motion.cost)
