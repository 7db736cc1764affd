"""Episodes of a task side by side: where they are, and what they cost so far."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.gym.rows import step_rows
from neuroanimator.state.arrays import AnyArray


class Episodes(NamedTuple):
    """Episodes under way, each a row."""

    latent: Float[np.ndarray, "B I"]
    controls: Float[np.ndarray, "B T C"]
    """The controls held; those still to come are zero."""
    states: Float[np.ndarray, "B T+1 S"]
    """The trajectories; states still to come are as the last one."""
    cost: Float[np.ndarray, " B"]
    """J if everything stayed as it is now."""
    first_cost: Float[np.ndarray, " B"]
    """J if everything had stayed as it began."""


def start_episodes(
    emulator: Emulator, objectives: Objective, starts: Float[np.ndarray, "B S"], steps: int
) -> Episodes:
    """Return the episodes of `steps` super steps that begin at `starts`; `objectives` is one for each row, stacked."""
    latent = np.asarray(emulator.encode(starts), np.float32)
    states = np.repeat(starts[:, None].astype(np.float32), steps + 1, axis=1)
    controls = np.zeros((len(starts), steps, emulator.control.size), np.float32)
    cost = _costs(emulator, objectives, controls, states)
    return Episodes(latent, controls, states, cost, cost)


def step_episodes(
    emulator: Emulator,
    objectives: Objective,
    episodes: Episodes,
    numbers: Int[np.ndarray, " B"],
    controls: Float[np.ndarray, "B C"],
) -> tuple[Episodes, Float[np.ndarray, " B"], Float[np.ndarray, " B"], Bool[np.ndarray, " B"]]:
    """Return the episodes one super step on, the rewards, how far to trust the step, and whether it is far away.

    `numbers` says how many super steps each row has made so far; one that has made them all changes nothing of its motion.
    """
    made = step_rows(emulator, episodes.latent, controls)
    is_to_come = np.arange(episodes.states.shape[1]) > numbers[:, None]
    states = np.where(is_to_come[..., None], made.states[:, None], episodes.states)
    is_held = np.arange(episodes.controls.shape[1]) == numbers[:, None]
    held = np.where(is_held[..., None], controls[:, None], episodes.controls)
    cost = _costs(emulator, objectives, held, states)
    with np.errstate(all="ignore"):  # a row that diverged costs no number
        rewards = (episodes.cost - cost) / episodes.first_cost
    following = Episodes(made.latent, held, states, cost, episodes.first_cost)
    return following, rewards, made.trust, made.ends_far


def _costs(
    emulator: Emulator,
    objectives: Objective,
    controls: Float[np.ndarray, "B T C"],
    states: Float[np.ndarray, "B T+1 S"],
) -> Float[np.ndarray, " B"]:
    """Return J of each row by its own of `objectives`."""
    scale = np.asarray(emulator.bounds.magnitude, np.float32)
    return np.asarray(_costs_in_jax(objectives, controls, states, scale, emulator.dt))


@eqx.filter_jit
def _costs_in_jax(
    objectives: Objective,
    controls: Float[AnyArray, "B T C"],
    states: Float[AnyArray, "B T+1 S"],
    scale: Float[AnyArray, " C"],
    dt: float,
) -> Float[AnyArray, " B"]:
    def cost(objective: Objective, held: Array, path: Array) -> Array:
        return objective(Trajectory(path, held, scale, dt))

    return eqx.filter_vmap(cost)(objectives, controls, states)
