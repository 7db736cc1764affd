"""Encodings: from a state to the latent state in which super steps are computed, and back.

For most systems super steps are computed in the state itself (`IdentityEncoding`); for a deformable body of
hundreds of mass points, in a rigid frame and a few shape modes (`shape_modes.ShapeModes`).
"""

from __future__ import annotations

import abc
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.features import Features
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import Layout
from neuroanimator.state.segments import Segment
from neuroanimator.state.structure import Structure

KEPT_MARGIN = 0.1
"""Share of its range by which a predicted number may leave it: further out predictions are meaningless."""


class Encoding(eqx.Module):
    """A map between states (S,) and latent states (I,), and between controls (C,) and latent controls (C,)."""

    @property
    @abc.abstractmethod
    def layout(self) -> Layout:
        """Named parts of a latent state (I,)."""

    @property
    @abc.abstractmethod
    def is_identity(self) -> bool:
        """Whether the latent state is the state itself."""

    @property
    @abc.abstractmethod
    def odd_controls(self) -> int:
        """Number of latent controls, the first ones, that change sign in the body's mirror; 0 without one."""

    @property
    @abc.abstractmethod
    def is_mirrored(self) -> bool:
        """Whether latent numbers are sorted into those that change sign in the body's mirror and those that do not."""

    @property
    @abc.abstractmethod
    def max_speed(self) -> float:
        """Maximum speed of the body that `bounded` allows [m/s]; infinite without a limit."""

    @property
    @abc.abstractmethod
    def max_angular_speed(self) -> float:
        """Maximum angular speed of the body that `bounded` allows [rad/s]; infinite without a limit."""

    @abc.abstractmethod
    def encode(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B I"]:
        """Return the latent states of `state` (..., S)."""

    @abc.abstractmethod
    def decode(self, latent: Float[AnyArray, "*B I"]) -> Float[AnyArray, "*B S"]:
        """Return the states of `latent` (..., I)."""

    @abc.abstractmethod
    def state_axes(self, latent_axes: tuple[int, ...]) -> tuple[int, ...]:
        """Return the axis along which each state entry moves with a latent state, as in `Origin`."""

    @abc.abstractmethod
    def encode_control(self, control: Float[AnyArray, "*B C"]) -> Float[AnyArray, "*B C"]:
        """Return the latent controls of `control` (..., C)."""

    @abc.abstractmethod
    def decode_control(self, latent: Float[AnyArray, "*B C"]) -> Float[AnyArray, "*B C"]:
        """Return the controls (..., C) that `encode_control` maps to `latent`."""

    @abc.abstractmethod
    def encode_recorded(self, states: Float[np.ndarray, "*B S"]) -> Float[np.ndarray, "*B I"]:
        """Return the latent states of `states` (..., S) in float32, computed in double precision."""

    @abc.abstractmethod
    def bounded(
        self, latent: Float[Array, " I"], features: Features, domain: Domain
    ) -> Float[Array, " I"]:
        """Return `latent` (I,) brought back near the training data where it is beyond.

        `features` gives the entries that a network sees unchanged, and `domain` their ranges.
        """

    @abc.abstractmethod
    def state_structure(self, latent_segments: tuple[Segment, ...]) -> Structure:
        """Return the structure of states (S,) that poses need, given the segments of latent states."""

    @abc.abstractmethod
    def check(self) -> None:
        """Refuse arrays that make every prediction NaN; ValueError names them."""

    @abc.abstractmethod
    def leaves(self) -> dict[str, Any]:
        """Return every array, or its placeholder, by its name in files: see docs/format.md."""

    @abc.abstractmethod
    def to_json(self) -> dict[str, Any] | None:
        """Return the JSON that, together with the arrays, makes up the encoding; None for the identity."""


class IdentityEncoding(Encoding):
    """The latent state is the state itself."""

    state: Layout = eqx.field(static=True)
    """Named parts of a state (S,)."""

    @property
    def layout(self) -> Layout:
        return self.state

    @property
    def is_identity(self) -> bool:
        return True

    @property
    def odd_controls(self) -> int:
        return 0

    @property
    def is_mirrored(self) -> bool:
        return False

    @property
    def max_speed(self) -> float:
        return math.inf

    @property
    def max_angular_speed(self) -> float:
        return math.inf

    def encode(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B S"]:
        return state

    def decode(self, latent: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B S"]:
        return latent

    def state_axes(self, latent_axes: tuple[int, ...]) -> tuple[int, ...]:
        return latent_axes

    def encode_control(self, control: Float[AnyArray, "*B C"]) -> Float[AnyArray, "*B C"]:
        return control

    def decode_control(self, latent: Float[AnyArray, "*B C"]) -> Float[AnyArray, "*B C"]:
        return latent

    def encode_recorded(self, states: Float[np.ndarray, "*B S"]) -> Float[np.ndarray, "*B S"]:
        return states.astype(np.float32, copy=False)

    def bounded(
        self, latent: Float[Array, " S"], features: Features, domain: Domain
    ) -> Float[Array, " S"]:
        """Return `latent` (S,) with the entries that a network sees unchanged brought into the range of training."""
        entries = features.plain
        if not entries:
            return latent
        low, high = domain.widened(KEPT_MARGIN, slice(len(entries)))
        shown = features.plain_of(latent)
        return features.with_plain(latent, jnp.clip(shown, low, high))

    def state_structure(self, latent_segments: tuple[Segment, ...]) -> Structure:
        return Structure((), (), (), segments=latent_segments)

    def check(self) -> None:
        return None

    def leaves(self) -> dict[str, Any]:
        return {}

    def to_json(self) -> None:
        return None
