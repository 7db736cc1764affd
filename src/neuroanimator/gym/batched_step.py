"""Super steps and observations for environments, row by row. In C if the `backend` is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from neuroanimator.control.policies.policy import latent_structure
from neuroanimator.control.policies.steering import leftward, unit
from neuroanimator.emulator.c_emulator import facts_of_emulator
from neuroanimator.emulator.c_rows import RowFunction
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.probes import probes_of
from neuroanimator.emulator.trust import EDGE
from neuroanimator.learn.tasks.task import Aim
from neuroanimator.state.pose import read_pose
from neuroanimator.state.segments import Position

MAX_OBSERVATION = 10.0
"""Maximum magnitude of observations: body and goal are of order one, and no episode goes far beyond training."""

FAR = 1.0
"""Distance outside the training range at which an episode ends, over the range's width: there the emulator only guesses."""


class Steps(NamedTuple):
    """Results of a super step, a row each."""

    states: Float[np.ndarray, "B S"]
    latent: Float[np.ndarray, "B I"]
    trust: Float[np.ndarray, " B"]
    """Trust score of the step's start: see `Emulator.trust`."""
    begins_far: Bool[np.ndarray, " B"]
    """Whether the step begins `FAR` outside training."""
    ends_far: Bool[np.ndarray, " B"]
    """Whether it ends there, or in NaN."""

    @property
    def info(self) -> dict[str, Shaped[np.ndarray, " B"]]:
        """Gymnasium's `info` of the step: its trust score, and whether that is within the edge of training."""
        return {"covered": self.trust <= EDGE, "trust": self.trust}


def step_rows(
    emulator: Emulator, latent: Float[np.ndarray, "B I"], controls: Float[np.ndarray, "B C"]
) -> Steps:
    """Return the results of a super step from the states `latent` under `controls`."""
    states, following, scores, *flags = STEP(emulator, latent, controls)
    return Steps(states, following, scores[:, 0], *[flag[:, 0] > 0 for flag in flags])


def step_row(
    emulator: Emulator, latent: Float[Array, " I"], control: Float[Array, " C"]
) -> tuple[Array, ...]:
    """Return the same for one row, in the order of `Steps`."""
    held = emulator.encode_control(control)
    following, score = emulator.step_latent_trusted(latent, held)
    state = emulator.decode(following)
    begins_near = is_near_training(emulator, emulator.raw_features(latent, held))
    ends_near = is_near_training(emulator, emulator.raw_features(following, held))
    ends_near &= jnp.all(jnp.isfinite(state))
    return state, following, score, ~begins_near, ~ends_near


def is_near_training(emulator: Emulator, features: Float[Array, " K"]) -> Bool[Array, ""]:
    """Return whether all `features`, as `Emulator.raw_features` gives them, are finite and at most `FAR` outside of training."""
    low, high = emulator.domain.widened(FAR, slice(None))
    return jnp.all((features >= low) & (features <= high) & jnp.isfinite(features))


class Aims(NamedTuple):
    """The observed parts of aims, as arrays."""

    position: Float[np.ndarray, "B 3"]
    """Positions of the goals in the world [m]; 0 along axes that do not matter."""
    matters: Float[np.ndarray, "B 3"]
    """1 for each axis along which the position matters, else 0."""
    direction: Float[np.ndarray, "B 3"]
    """Unit vectors in the world along which the bodies should point or move; zeros if they do not matter."""

    @classmethod
    def of(cls, aims: Sequence[Aim]) -> Aims:
        """Return `aims` as arrays, a row each."""
        position = np.array([aim.position for aim in aims], np.float32)
        matters = np.isfinite(position)
        direction = np.array([aim.direction for aim in aims], np.float32)
        return cls(np.where(matters, position, 0), matters.astype(np.float32), direction)


class Observer(eqx.Module):
    """An agent's observation of an emulator's state and of its aim."""

    emulator: Emulator
    scale: float = eqx.field(static=True)
    """Unit of distances [m]."""
    is_in_a_fixed_world: bool = eqx.field(static=True)
    """Whether the position in the world is observed, too."""


def observe_rows(
    observer: Observer,
    latent: Float[np.ndarray, "B I"],
    aims: Aims,
    time_left: Float[np.ndarray, " B"],
) -> Float[np.ndarray, "B O"]:
    """Return the observations, see `TaskEnv`; `time_left` is the remaining share of the episodes' time."""
    (observations,) = OBSERVE(observer, latent, *aims, time_left[:, None])
    return observations


def observe_row(
    observer: Observer,
    latent: Float[Array, " I"],
    position: Float[Array, " 3"],
    matters: Float[Array, " 3"],
    direction: Float[Array, " 3"],
    time_left: Float[Array, " 1"],
) -> tuple[Float[Array, " O"]]:
    """Return the same for one row, with its aim as in `Aims`."""
    emulator = observer.emulator
    relaxed = emulator.encode_control(jnp.asarray(emulator.bounds.middle, latent.dtype))
    features = emulator.normaliser.forward(emulator.raw_features(latent, relaxed))
    odd, even = emulator.features.streams(latent, features)
    goal: list[Array] = []
    structure = latent_structure(emulator)
    if any(isinstance(segment, Position) for segment in structure.segments):
        pose = read_pose(structure, latent)
        left = leftward(pose)
        axes = jnp.stack([pose.forward, left, unit(jnp.cross(pose.forward, left))])
        offset = (position - pose.position) * matters / observer.scale
        goal = [axes @ offset, axes @ direction, axes[:, 2]]
        if observer.is_in_a_fixed_world:
            goal += [pose.position / observer.scale, pose.forward]
    observation = jnp.concatenate([odd, even, *goal, time_left])
    return (jnp.clip(jnp.nan_to_num(observation), -MAX_OBSERVATION, MAX_OBSERVATION),)


def _step_samples(emulator: Emulator) -> list[Float[np.ndarray, "N _"]]:
    """Return a thousand latent states and controls: some far outside the training data."""
    states, controls = probes_of(emulator).inputs
    return [emulator.encode(states), controls]


def _observer_samples(observer: Observer) -> list[Float[np.ndarray, "N _"]]:
    """Return a thousand latent states, aims and times."""
    rng = np.random.default_rng(0)
    latent, _ = _step_samples(observer.emulator)
    count = len(latent)
    positions = rng.normal(scale=3 * observer.scale, size=(count, 3))
    matters = rng.integers(0, 2, (count, 3)).astype(float)
    directions = unit(rng.normal(size=(count, 3)))
    times = rng.uniform(0, 1, (count, 1))
    return [latent, matters * positions, matters, directions, times]


def _facts_of_observer(observer: Observer) -> list[str]:
    settings = f"{observer.scale} {observer.is_in_a_fixed_world}"
    return [*facts_of_emulator(observer.emulator), settings]


STEP = RowFunction(step_row, facts_of_emulator, _step_samples)
OBSERVE = RowFunction(observe_row, _facts_of_observer, _observer_samples)
