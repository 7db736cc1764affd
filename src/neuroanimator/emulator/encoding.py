"""Encodings: from a state to the latent state in which super steps are computed, and back.

For most systems super steps are computed in the state itself (`StateEncoding`); for a deformable body of
hundreds of mass points, in a rigid frame and a few shape modes (`shape_modes.ShapeModes`).
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.domain import Domain
from neuroanimator.emulator.features import Features
from neuroanimator.files.numbers import entries
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.body_frame import PROBE_FEATURES
from neuroanimator.state.layout import Layout
from neuroanimator.state.segments import Segment
from neuroanimator.state.structure import (
    REVERSED_ABOUT,
    REVERSED_ALONG,
    Structure,
    mixing,
    pairs_up,
)

ACTIVATIONS = "activations"
"""Name of the part of a state that holds those of muscles."""

PARTNERS = "partners"
"""Key of a mirror in files."""

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
    def control_partners(self) -> tuple[int, ...]:
        """Partner of each control in the body's mirror; empty without one."""

    keeps_entries: ClassVar[bool]
    """Whether latent numbers are entries of the state, in their order, but for mixtures of activations."""

    @property
    def is_identity(self) -> bool:
        """Whether the latent state is the state itself."""
        return self.keeps_entries and not self.is_mirrored

    @property
    def odd_controls(self) -> int:
        """Number of latent controls, the first ones, that change sign in the body's mirror; 0 without one."""
        return mixing(self.control_partners)[1] if self.control_partners else 0

    @property
    @abc.abstractmethod
    def is_mirrored(self) -> bool:
        """Whether latent numbers are sorted into those that change sign in the body's mirror and those that do not."""

    @property
    def max_speed(self) -> float:
        """Maximum speed of the body that `bounded` allows [m/s]; infinite without a limit."""
        return math.inf

    @property
    def max_angular_speed(self) -> float:
        """Maximum angular speed of the body that `bounded` allows [rad/s]; infinite without a limit."""
        return math.inf

    @abc.abstractmethod
    def encode(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B I"]:
        """Return the latent states of `state` (..., S)."""

    @abc.abstractmethod
    def decode(self, latent: Float[AnyArray, "*B I"]) -> Float[AnyArray, "*B S"]:
        """Return the states of `latent` (..., I)."""

    @abc.abstractmethod
    def state_axes(self, latent_axes: tuple[int, ...]) -> tuple[int, ...]:
        """Return the axis along which each state entry moves with a latent state, as in `Origin`."""

    def encode_control(self, control: Float[AnyArray, "*B C"]) -> Float[AnyArray, "*B C"]:
        """Return the latent controls of `control` (..., C): with a mirror, differences of left and right, then sums."""
        return control @ self._mix(control) if self.control_partners else control

    def decode_control(self, latent: Float[AnyArray, "*B C"]) -> Float[AnyArray, "*B C"]:
        """Return the controls (..., C) that `encode_control` maps to `latent`."""
        return latent @ self._mix(latent).mT if self.control_partners else latent

    def odd_muscles(self) -> tuple[bool, ...]:
        """Return (C,) whether the mirror reverses each latent control."""
        return tuple(number < self.odd_controls for number in range(len(self.control_partners)))

    def _mix(self, like: AnyArray) -> Float[AnyArray, "C C"]:
        """Return the mixing of left and right as an array of the library and the type of `like`."""
        return like.__array_namespace__().asarray(
            mixing(self.control_partners)[0], dtype=like.dtype
        )

    @abc.abstractmethod
    def odd_changes(self, body: Structure) -> tuple[bool, ...]:
        """Return (V,) whether the mirror of the `body` reverses each number of a change of the latent state."""

    @abc.abstractmethod
    def odd_features(self, body: Structure) -> tuple[bool, ...]:
        """Return (K,) whether the mirror of the `body` reverses each raw feature."""

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

    def check(self) -> None:
        """Refuse arrays that make every prediction NaN; ValueError names them."""

    @abc.abstractmethod
    def to_json(self) -> dict[str, Any] | None:
        """Return the JSON that, together with the arrays, makes up the encoding; None for the identity."""


def odd_local(body: Structure) -> tuple[bool, ...]:
    """Return whether the mirror reverses each number that a frame shows: direction of gravity, velocity, the probes'."""
    gravity = REVERSED_ALONG if body.has_gravity else ()
    return (*gravity, *REVERSED_ALONG, *(False,) * (PROBE_FEATURES * len(body.probes)))


class StateEncoding(Encoding):
    """The latent state is the state itself, but for muscles with a mirror: differences of left and right, then sums."""

    keeps_entries = True

    state: Layout = eqx.field(static=True)
    """Named parts of a state (S,)."""
    partners: tuple[int, ...] = eqx.field(static=True, default=())
    """Partner of each muscle in the mirror; empty without one."""

    @classmethod
    def from_json(cls, described: Any, state: Layout, controls: int) -> StateEncoding:
        """Return the encoding that `to_json` wrote; ValueError names the fault."""
        partners = entries(described[PARTNERS], "modes: partners", controls)
        if not pairs_up(partners, controls):
            raise ValueError("modes: a mirror that does not pair left and right")
        if (ACTIVATIONS, controls) not in [(part.name, part.size) for part in state.slices]:
            raise ValueError("modes: wanted as many activations as controls")
        return cls(state, partners)

    @property
    def layout(self) -> Layout:
        return self.state

    @property
    def control_partners(self) -> tuple[int, ...]:
        return self.partners

    @property
    def is_mirrored(self) -> bool:
        return bool(self.partners)

    def encode(self, state: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B S"]:
        return self._with_muscles(state, self.encode_control)

    def decode(self, latent: Float[AnyArray, "*B S"]) -> Float[AnyArray, "*B S"]:
        return self._with_muscles(latent, self.decode_control)

    def _with_muscles(
        self, state: Float[AnyArray, "*B S"], coded: Callable[[AnyArray], AnyArray]
    ) -> Float[AnyArray, "*B S"]:
        """Return `state` with its activations in the other code."""
        if not self.partners:
            return state
        at = self.state.index(ACTIVATIONS)
        parts = [state[..., : at.start], coded(state[..., at]), state[..., at.stop :]]
        return state.__array_namespace__().concat(parts, axis=-1)

    def state_axes(self, latent_axes: tuple[int, ...]) -> tuple[int, ...]:
        return latent_axes

    def odd_changes(self, body: Structure) -> tuple[bool, ...]:
        assert body.swimmer is not None
        return (*REVERSED_ALONG, *REVERSED_ABOUT, *REVERSED_ALONG, *body.swimmer.odd)

    def odd_features(self, body: Structure) -> tuple[bool, ...]:
        assert body.swimmer is not None
        muscles = self.odd_muscles()
        return (*body.swimmer.odd, *muscles, *odd_local(body), *muscles)

    def encode_recorded(self, states: Float[np.ndarray, "*B S"]) -> Float[np.ndarray, "*B S"]:
        return self.encode(states).astype(np.float32, copy=False)

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

    def to_json(self) -> dict[str, Any] | None:
        return {PARTNERS: list(self.partners)} if self.partners else None
