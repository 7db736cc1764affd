"""Episodes of a task side by side, as JAX sees them: the compiled part of `task_envs`."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.control.policies.policy import latent_structure
from neuroanimator.control.policies.steering import leftward, unit
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.pose import read_pose
from neuroanimator.state.segments import Position
from neuroanimator.tasks.task import Aim

MAX_OBSERVATION = 10.0
"""Observations are kept within ± this: body and goal are of order one, and no episode goes far beyond training."""

FAR = 1.0
"""An episode ends this many widths of the training range outside it: there the emulator only guesses."""


class AimArrays(eqx.Module):
    """An aim as arrays: what is observed of it."""

    position: Float[Array, " 3"]
    """Where the goal is in the world [m]; 0 along axes that do not matter."""
    matters: Float[Array, " 3"]
    """1 for each axis along which the position matters, else 0."""
    direction: Float[Array, " 3"]
    """The unit vector in the world where the body shall point or go; zeros if it does not matter."""

    @classmethod
    def from_aim(cls, aim: Aim) -> AimArrays:
        """Return `aim` as arrays."""
        position = np.array(aim.position)
        matters = np.isfinite(position)
        return cls(
            jnp.asarray(np.where(matters, position, 0.0), jnp.float32),
            jnp.asarray(matters, jnp.float32),
            jnp.asarray(aim.direction, jnp.float32),
        )


class Episodes(eqx.Module):
    """Episodes under way, each a row: what the compiled step needs and gives back."""

    latent: Float[Array, "*B I"]
    controls: Float[Array, "*B T C"]
    """The controls held; those still to come are zero."""
    states: Float[Array, "*B T+1 S"]
    """The trajectories; states still to come are as the last one."""
    cost: Float[Array, "*B"]
    """J if everything stayed as it is now."""
    first_cost: Float[Array, "*B"]
    """J if everything had stayed as it began."""


def _cost(
    emulator: Emulator,
    objective: Objective,
    controls: Float[Array, "T C"],
    states: Float[Array, "T+1 S"],
) -> Float[Array, ""]:
    control_scale = jnp.asarray(emulator.bounds.magnitude, jnp.float32)
    return objective(Trajectory(states, controls, control_scale, emulator.dt))


@eqx.filter_jit
def start_episodes(
    emulator: Emulator,
    objectives: Objective,
    latent: Float[Array, "B I"],
    starts: Float[Array, "B S"],
    steps: int,
) -> Episodes:
    """Return the episodes that begin at `starts`, in JAX as `latent`, for `steps` super steps.

    `objectives` is one for each row, stacked.
    """
    states = jnp.repeat(starts[:, None], steps + 1, axis=1)
    controls = jnp.zeros((len(starts), steps, emulator.control.size))
    cost = eqx.filter_vmap(_cost, in_axes=(None, 0, 0, 0))(emulator, objectives, controls, states)
    return Episodes(latent, controls, states, cost, cost)


@eqx.filter_jit
def step_episodes(
    emulator: Emulator,
    objectives: Objective,
    episodes: Episodes,
    numbers: Int[Array, " B"],
    controls: Float[Array, "B C"],
) -> tuple[Episodes, Float[Array, " B"], Bool[Array, " B"], Bool[Array, " B"]]:
    """Return the episodes one super step on, the rewards, whether training covered the step, and whether it is far away.

    `numbers` says how many super steps each row has made so far.
    """
    return eqx.filter_vmap(_step_row, in_axes=(None, 0, 0, 0, 0))(
        emulator, objectives, episodes, numbers, controls
    )


def _step_row(
    emulator: Emulator,
    objective: Objective,
    episode: Episodes,
    number: Int[Array, ""],
    control: Float[Array, " C"],
) -> tuple[Episodes, Float[Array, ""], Bool[Array, ""], Bool[Array, ""]]:
    """Return the same for one episode, at its super step of that `number`."""
    held = emulator.encode_control(control)
    latent = emulator.step_latent(episode.latent, held)
    state = emulator.decode(latent)
    is_near = is_near_training(emulator, emulator.raw_features(latent, held))
    is_far = ~(is_near & jnp.all(jnp.isfinite(state)))
    is_to_come = jnp.arange(len(episode.states)) > number
    states = jnp.where(is_to_come[:, None], state, episode.states)
    controls = episode.controls.at[number].set(control)
    cost = _cost(emulator, objective, controls, states)
    reward = (episode.cost - cost) / episode.first_cost
    following = Episodes(latent, controls, states, cost, episode.first_cost)
    return following, reward, emulator.covers_encoded(episode.latent), is_far


def is_near_training(emulator: Emulator, features: Float[Array, "*B K"]) -> Bool[Array, ""]:
    """Return whether all `features`, as `Emulator.seen` gives them, are finite and at most `FAR` outside of training."""
    low, high = emulator.domain.widened(FAR, slice(None))
    return jnp.all((features >= low) & (features <= high) & jnp.isfinite(features))


@eqx.filter_jit
def observe(
    emulator: Emulator,
    latent: Float[Array, "B I"],
    aims: AimArrays,
    time_left: Float[Array, " B"],
    scale: float,
    is_in_a_fixed_world: bool,
) -> Float[Array, "B O"]:
    """Return the observations; see `TaskEnv`.

    `time_left` is the share of the episodes' time that is left, `scale` [m] the length distances are counted in, and
    `is_in_a_fixed_world` says whether the position in the world is observed, too.
    """

    def observe_row(latent: Array, aim: AimArrays, time_left: Array) -> Array:
        relaxed = emulator.encode_control(jnp.asarray(emulator.bounds.middle, latent.dtype))
        features = emulator.normaliser.forward(emulator.raw_features(latent, relaxed))
        odd, even = emulator.features.streams(latent, features)
        goal = _observe_goal(emulator, latent, aim, scale, is_in_a_fixed_world)
        observation = jnp.concatenate([odd, even, *goal, time_left[None]])
        return jnp.clip(jnp.nan_to_num(observation), -MAX_OBSERVATION, MAX_OBSERVATION)

    return eqx.filter_vmap(observe_row)(latent, aims, time_left)


def _observe_goal(
    emulator: Emulator,
    latent: Float[Array, " I"],
    aim: AimArrays,
    scale: float,
    is_in_a_fixed_world: bool,
) -> list[Float[Array, " 3"]]:
    """Return the goal's position, the direction to go and up, all along the body's axes; nothing if it has none."""
    structure = latent_structure(emulator)
    if not any(isinstance(segment, Position) for segment in structure.segments):
        return []
    pose = read_pose(structure, latent)
    left = leftward(pose)
    axes = jnp.stack([pose.forward, left, unit(jnp.cross(pose.forward, left))])
    offset = (aim.position - pose.position) * aim.matters / scale
    observed = [axes @ offset, axes @ aim.direction, axes[:, 2]]
    if is_in_a_fixed_world:
        observed += [pose.position / scale, pose.forward]
    return observed
