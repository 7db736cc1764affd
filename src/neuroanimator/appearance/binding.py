"""Bones that follow mass points: their positions and orientations as weighted sums of the points' positions."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

from neuroanimator.state.rotation import NO_ROTATION, quaternions_of

MAX_POINTS = 300
"""Maximum number of mass points a bone may follow: a skeleton may come from a stranger."""

SUM_TOLERANCE = 1e-6
"""Tolerance of sums of weights read from a file: they were rounded when they were written."""

MIN_LENGTH = 1e-12
"""Smallest length that a direction is divided by [m], so that none is 0/0."""

Entry = Annotated[int, Field(strict=True, ge=0, le=10**6)]
Weight = Annotated[float, Field(strict=True, ge=-1, le=1, allow_inf_nan=False)]
Weights = tuple[tuple[Entry, Weight], ...]
"""Mass points: the first of the three state entries of each one's position, and its weight."""


Pose = tuple[Float[np.ndarray, "T 3"], Float[np.ndarray, "T 4"]]
"""Positions [m] and orientations wxyz of one bone in T states."""


class Binding(BaseModel):
    """A bone's attachment to mass points.

    It lies at the weighted mean `position`. Its X axis points along the weighted difference `forward`, its Z axis
    along the part of `up` across it (Gram and Schmidt); without them it keeps the world's axes. Moving
    and rotating all mass points moves and rotates a bone that has both.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    position: Weights = Field(min_length=1, max_length=MAX_POINTS, fail_fast=True)
    """Weights of the mean; they add up to 1."""
    forward: Annotated[Weights, Field(max_length=MAX_POINTS, fail_fast=True)] = ()
    """Weights of the direction of X; they add up to 0."""
    up: Annotated[Weights, Field(max_length=MAX_POINTS, fail_fast=True)] = ()
    """Weights of the direction of Z; they add up to 0."""

    @model_validator(mode="after")
    def _check_sums(self) -> Binding:
        for name, wanted in (("position", 1.0), ("forward", 0.0), ("up", 0.0)):
            weights = getattr(self, name)
            total = sum(weight for _, weight in weights)
            if abs(total - wanted) > SUM_TOLERANCE:
                raise ValueError(f"weights of '{name}' do not add up to {wanted:g}")
        if bool(self.forward) != bool(self.up):
            raise ValueError("wanted both of forward and up, or neither")
        return self

    @property
    def last_entry(self) -> int:
        """Last state entry that is read."""
        weights = (*self.position, *self.forward, *self.up)
        return 2 + max(entry for entry, _ in weights)


def bound_pose(binding: Binding, states: Float[np.ndarray, "T S"]) -> Pose:
    """Return positions [m] and orientations wxyz in the world, for every state."""
    position = _weighted_sum(binding.position, states)
    if not binding.forward:
        return position, np.broadcast_to(NO_ROTATION, (len(states), 4))
    x_axis = _unit(_weighted_sum(binding.forward, states))
    up = _weighted_sum(binding.up, states)
    along_x = (up * x_axis).sum(axis=-1, keepdims=True) * x_axis
    z_axis = _unit(up - along_x)
    y_axis = np.cross(z_axis, x_axis)
    axes = np.stack([x_axis, y_axis, z_axis], axis=-1)
    return position, quaternions_of(axes)


def _weighted_sum(weights: Weights, states: Float[np.ndarray, "T S"]) -> Float[np.ndarray, "T 3"]:
    total = np.zeros((len(states), 3))
    for entry, weight in weights:
        total = total + weight * states[:, entry : entry + 3]
    return total


def _unit(vectors: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(lengths, MIN_LENGTH)
