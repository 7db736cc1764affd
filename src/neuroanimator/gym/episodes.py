"""Episodes of a task side by side, as JAX sees them: what `gym_tasks` compiles."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.objective.objective import Objective
from neuroanimator.control.objective.trajectory import Trajectory
from neuroanimator.control.policies.policy import latent_structure
from neuroanimator.control.policies.steering import leftward, unit
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.pose import read_pose
from neuroanimator.tasks.task import Aim

MAX_DISTANCE = 10.0
"""Observations are kept within ± this: body and goal are of order one, and no episode goes far beyond training."""
FAR = 1.0
"""An episode ends this many widths of the training range outside it: there the emulator only guesses."""


class Sight(eqx.Module):
    """What is observed of an aim."""

    position: Float[Array, " 3"]
    matters: Float[Array, " 3"]
    """1 for each axis along which the place matters, else 0."""
    direction: Float[Array, " 3"]

    @classmethod
    def of(cls, aim: Aim) -> Sight:
        """Return the aim as arrays."""
        position = np.array(aim.position)
        matters = np.isfinite(position)
        kept = np.where(matters, position, 0.0)
        return cls(*(jnp.asarray(part, jnp.float32) for part in (kept, matters, aim.direction)))


class Episodes(eqx.Module):
    """Episodes under way, each a row: what the compiled step needs and gives back."""

    latent: Float[Array, "B I"]
    states: Float[Array, "B T+1 S"]
    """Those still to come are as the last one."""
    controls: Float[Array, "B T C"]
    """Those still to come are zero."""
    cost: Float[Array, " B"]
    """J if everything stayed as it is now."""
    first_cost: Float[Array, " B"]
    """J if everything had stayed as it began."""


def _cost(emulator: Emulator, objective: Objective, states: Array, controls: Array) -> Array:
    control_scale = jnp.asarray(emulator.bounds.magnitude, jnp.float32)
    return objective(Trajectory(states, controls, control_scale, emulator.dt))


@eqx.filter_jit
def start_episodes(
    emulator: Emulator, objectives: Objective, latent: Array, starts: Array, steps: int
) -> Episodes:
    """Return the episodes that begin at `starts` (B, S), for `steps` super steps."""
    states = jnp.repeat(starts[:, None], steps + 1, axis=1)
    controls = jnp.zeros((len(starts), steps, emulator.control.size))
    cost = eqx.filter_vmap(_cost, in_axes=(None, 0, 0, 0))(emulator, objectives, states, controls)
    return Episodes(latent, states, controls, cost, cost)


@eqx.filter_jit
def step_episodes(
    emulator: Emulator, objectives: Objective, episodes: Episodes, number: Array, controls: Array
) -> tuple[Episodes, Array, Array, Array]:
    """Return the episodes one super step on, and (B,) rewards, whether training covered it, whether it is far away."""
    return eqx.filter_vmap(_step_one, in_axes=(None, 0, 0, 0, 0))(
        emulator, objectives, episodes, number, controls
    )


def _step_one(
    emulator: Emulator, objective: Objective, episode: Episodes, number: Array, control: Array
) -> tuple[Episodes, Array, Array, Array]:
    """Return the same for one episode, at its super step of that `number`."""
    held, domain = emulator.encode_control(control), emulator.domain
    latent = emulator.step_latent(episode.latent, held)
    state = emulator.decode(latent)
    plain = emulator.seen(latent, held)
    margin = FAR * (domain.high - domain.low)
    is_near = jnp.all(
        (plain >= domain.low - margin) & (plain <= domain.high + margin) & jnp.isfinite(plain)
    )
    is_to_come = jnp.arange(len(episode.states)) > number
    states = jnp.where(is_to_come[:, None], state, episode.states)
    controls = episode.controls.at[number].set(control)
    cost = _cost(emulator, objective, states, controls)
    reward = (episode.cost - cost) / episode.first_cost
    following = Episodes(latent, states, controls, cost, episode.first_cost)
    return (
        following,
        reward,
        emulator.covers_encoded(episode.latent),
        ~(is_near & jnp.all(jnp.isfinite(state))),
    )


@eqx.filter_jit
def observe(
    emulator: Emulator, latent: Array, sights: Sight, left: Array, scale: float, sees_world: bool
) -> Float[Array, "B O"]:
    """Return the observations; see `TaskEnv`."""

    def one(latent: Array, sight: Sight, left: Array) -> Array:
        relaxed = emulator.encode_control(jnp.asarray(emulator.bounds.middle, latent.dtype))
        plain = emulator.normaliser.forward(emulator.seen(latent, relaxed))
        odd, even = emulator.features.streams(latent, plain)
        seen = [odd, even, *_goal_seen(emulator, latent, sight, scale, sees_world), left[None]]
        return jnp.clip(jnp.nan_to_num(jnp.concatenate(seen)), -MAX_DISTANCE, MAX_DISTANCE)

    return eqx.filter_vmap(one)(latent, sights, left)


def _goal_seen(
    emulator: Emulator, latent: Array, sight: Sight, scale: float, sees_world: bool
) -> list[Array]:
    """Return the goal's place, the wished direction and up, along the body's axes; nothing if it has none."""
    structure = latent_structure(emulator)
    if not any(segment.kind == "position" for segment in structure.segments):
        return []
    pose = read_pose(structure, latent)
    left = leftward(pose)
    axes = jnp.stack([pose.forward, left, unit(jnp.cross(pose.forward, left))])
    way = (sight.position - pose.position) * sight.matters / scale
    seen = [axes @ way, axes @ sight.direction, axes[:, 2]]
    return [*seen, pose.position / scale, pose.forward] if sees_world else seen
