"""What makes physics a task: what is observed, what a step earns, where episodes begin and when they end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

RowReward = Callable[
    [Float[np.ndarray, "B S"], Float[np.ndarray, "B C"], Float[np.ndarray, "B S"], float],
    Float[np.ndarray, " B"],
]
"""(states, controls, states one step later, duration of that step [s]) → rewards, in NumPy, of many rows at once."""

Observer = Callable[[Float[np.ndarray, "B S"]], Float[np.ndarray, "B O"]]
"""States → what a policy is shown of them."""

Ending = Callable[[Float[np.ndarray, "B S"]], Bool[np.ndarray, " B"]]
"""States after a step → whether the episode is over, as the task has it."""

StartDraw = Callable[[np.random.Generator], Float[np.ndarray, " S"]]
"""Random numbers → the state an episode begins with."""


def whole_state(states: Float[np.ndarray, "B S"]) -> Float[np.ndarray, "B S"]:
    """Return the states: all of them is observed."""
    return states


def never(states: Float[np.ndarray, "B S"]) -> Bool[np.ndarray, " B"]:
    """Return that no row is over."""
    return np.zeros(len(states), bool)


@dataclass(frozen=True)
class EpisodeRules:
    """A task in functions of many rows: whatever physics steps the states, the same rules hold.

    A policy learnt in an emulator by the rules of an environment acts in that environment as it is.
    """

    reward: RowReward
    observe: Observer = whole_state
    is_over: Ending = never
    draw_start: StartDraw | None = None
    """None: near rest, see `starts_near_rest`."""
    steps: int | None = None
    """Super steps after which an episode is truncated; None: as many as fill the usual time."""
