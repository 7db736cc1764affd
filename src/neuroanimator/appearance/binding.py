"""Bones that go with mass points, by weighted sums of their places."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from neuroanimator.state.rotation import quaternions_of

MAX_POINTS = 300
"""A skeleton may come from a stranger."""
LOOSE = 1e-6
"""How far sums of weights read from a file may be off."""
SMALLEST = 1e-12
"""[m] Directions are never divided by less, so that none is 0/0."""

Entry = Annotated[int, Field(ge=0, le=10**6)]
Weight = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
Weights = tuple[tuple[Entry, Weight], ...]
"""Of mass points: the first of the three state entries of each one's place, and how much it counts."""


class Binding(BaseModel):
    """How a bone goes with mass points.

    It lies at the weighted mean `position`. Its X axis points along the weighted difference `forward`, its Z axis
    along `up` as far as that is across (Gram and Schmidt); without them it keeps the world's axes. Moving
    and turning all mass points moves and turns a bone that has both.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    position: Weights = Field(min_length=1, max_length=MAX_POINTS)
    """Weights add up to 1."""
    forward: Annotated[Weights, Field(max_length=MAX_POINTS)] = ()
    """Weights add up to 0."""
    up: Annotated[Weights, Field(max_length=MAX_POINTS)] = ()
    """Weights add up to 0."""

    @model_validator(mode="after")
    def _sums(self) -> Binding:
        for name, wanted in (("position", 1.0), ("forward", 0.0), ("up", 0.0)):
            if (
                abs(sum(weight for _, weight in getattr(self, name)) - wanted * bool(self.position))
                > LOOSE
            ):
                raise ValueError(f"weights of '{name}' do not add up to {wanted:g}")
        if bool(self.forward) != bool(self.up):
            raise ValueError("wanted both of forward and up, or neither")
        return self

    @property
    def last_entry(self) -> int:
        """The last state entry that is read."""
        return 2 + max(entry for entry, _ in (*self.position, *self.forward, *self.up))


def binding_from_json(row: Any) -> Binding:
    """Return what `Binding.model_dump` wrote; ValueError names what is wrong with it."""
    listed = {key: [tuple(pair) for pair in value] for key, value in dict(row).items()}
    return Binding.model_validate({key: tuple(value) for key, value in listed.items()})


def bound_pose(binding: Binding, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places (T, 3) [m] and quaternions wxyz (T, 4) in the world, for states (T, S)."""
    position = _sum(binding.position, states)
    if not binding.forward:
        return position, np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(states), 4))
    forward = _unit(_sum(binding.forward, states))
    up = _sum(binding.up, states)
    up = _unit(up - (up * forward).sum(axis=-1, keepdims=True) * forward)
    axes = np.stack([forward, np.cross(up, forward), up], axis=-1)
    return position, quaternions_of(axes)


def _sum(weights: Weights, states: np.ndarray) -> np.ndarray:
    return sum(
        (weight * states[:, entry : entry + 3] for entry, weight in weights),
        np.zeros((len(states), 3)),
    )


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), SMALLEST)
