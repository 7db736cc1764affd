"""Policies: networks from a body's state and an abstract command to its muscles, forward(s, v) → u (SIGGRAPH 98).

A policy has the features of its emulator, so position and heading do not matter to it. A clock gives it the rhythm
of swimming; the system's gait is its initial guess. Mirrored inputs give mirrored controls.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.control.policies.abstract_policy import (
    PROBED_STATES,
    AbstractPolicy,
    read_policy_file,
    read_widths,
)
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.features import reordered
from neuroanimator.emulator.networks import make_network
from neuroanimator.emulator.networks.network import Network, prefixed
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.errors import ArgumentError
from neuroanimator.files.atomic import Metadata, digest
from neuroanimator.files.zoo import find_policy
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.pose import Pose, read_pose
from neuroanimator.state.structure import Structure

COMMAND = Layout(
    (
        Slice("speed", 1, "m/s"),
        Slice("turn", 1, "rad"),
        Slice("climb", 1, "rad"),
        Slice("roll", 1, "rad"),
    )
)
"""Entries of a command: the forward speed, and the angles still to turn left, to pitch up and to roll to the right,
as seen from the body."""

EVEN_COMMANDS = slice(0, None, 2)
"""Commands that the mirror leaves unchanged: speed and climb."""

ODD_COMMANDS = slice(1, None, 2)
"""Commands that the mirror reverses: turn and roll."""

CLOCK_SIZE = 2
"""Number of features of the clock's phase: its sine and its cosine."""

NEARLY_IDLE = 0.8
"""Largest share of half the range by which controls are idle off the middle: at the bounds gradients would vanish."""

DEFAULT_PERIOD = 1.0
"""Period of the clock without a gait [s]."""


class Rhythm(NamedTuple):
    """The waves that a clock gives to the muscles: amplitude · sin(phase - lag), full at the maximum speed."""

    period: float
    """Time of one turn of the clock [s]."""
    amplitudes: tuple[float, ...]
    """Amplitudes (C,), each in its control's unit."""
    lags: tuple[float, ...]
    """Phase lags (C,) of the controls behind the clock [rad]."""
    is_odd: bool
    """Whether left and right alternate, so that half a period later is the mirror image."""

    @classmethod
    def from_emulator(cls, emulator: Emulator) -> Rhythm:
        """Return the rhythm of the emulator's gait; without one, a clock alone."""
        gait = emulator.gait
        if gait is None:
            still = (0.0,) * emulator.control.size
            return cls(DEFAULT_PERIOD, still, still, is_odd=False)
        waves = np.array(gait.amplitudes) * np.exp(-1j * np.array(gait.lags))
        mixed = [emulator.encode_control(part) for part in (waves.real, waves.imag)]
        sizes = np.abs(np.stack(mixed))
        odd = emulator.encoding.odd_controls
        is_odd = bool(sizes[:, :odd].sum() > sizes[:, odd:].sum())
        return cls(gait.period, gait.amplitudes, gait.lags, is_odd)


class Policy(AbstractPolicy):
    """u = middle + half · tanh(idle + waves of the gait + network(features of the body, clock, command)).

    The features are those of the emulator it was trained through.
    """

    KIND = "policy"
    FORMAT = 2
    MAKER = "train_policy"

    network: Network
    ranges: Bounds = eqx.field(static=True)
    """Range of each command in training, in the order of `COMMAND`."""
    rhythm: Rhythm = eqx.field(static=True)
    observes_parameters: bool = eqx.field(static=True, default=True)
    """Whether the network gets the parameters of a family's body; if not, it is robust against them at best."""

    @property
    def tick(self) -> float:
        """Advance of the clock's phase in one super step [rad]."""
        return 2 * math.pi * self.dt / self.rhythm.period

    def control(
        self, latent: Float[Array, " I"], phase: Float[Array, ""], command: Float[Array, " 4"]
    ) -> Float[Array, " C"]:
        """Return the control for a body in the state `latent` (see `Emulator.encode`) at `phase` [rad] of the clock.

        Commands are clipped to their ranges. Differentiable, unchecked: for use inside jit.
        """
        emulator = self.emulator
        bounds = emulator.bounds
        normalised = self._normalised(command)
        odd, even = self._streams(latent, phase, normalised)
        mixed = self.network(odd, even)
        steered = emulator.encoding.decode_control(mixed)
        amplitudes = jnp.asarray(self.rhythm.amplitudes)
        lags = jnp.asarray(self.rhythm.lags)
        # The wave at the middle of the super step, full at the maximum speed, zero at the minimum.
        waves = amplitudes * jnp.sin(phase + self.tick / 2 - lags) * (normalised[0] + 1) / 2
        raw = steered + waves
        if (
            emulator.skeleton.shapes is not None
        ):  # muscles of flesh only pull: by themselves they are nearly idle
            share = (bounds.idle - bounds.middle) / bounds.half
            raw = raw + np.arctanh(np.clip(share, -NEARLY_IDLE, NEARLY_IDLE))
        return self._off_middle(jnp.tanh(raw))

    def pose(self, latent: Float[AnyArray, "*B I"]) -> Pose:
        """Return the poses of bodies in the latent states `latent` of `Emulator.encode`."""
        return read_pose(latent_structure(self.emulator), latent)

    @classmethod
    def load(cls, path: str | Path) -> Policy:
        """Return the policy in the file at `path`, or the shipped one of that name, such as `fish`.

        Raises BadFileError with what is wrong with the file, or the list of names.
        """
        return load_policy(path)

    def _own_leaves(self) -> dict[str, Any]:
        return prefixed("network", self.network.leaves())

    def _own_description(self) -> dict[str, Any]:
        described = {
            "emulator_sha256": digest(emulator_tensors(self.emulator)),
            "command": COMMAND.to_json(),
            "ranges": [list(self.ranges.low), list(self.ranges.high)],
            "widths": list(self.network.widths),
        }
        # Older readers, which do not know such policies, refuse them: they have fewer weights.
        if not self.observes_parameters:
            described["observes_parameters"] = False
        return described

    @classmethod
    def _blank(cls, metadata: Metadata, emulator: Emulator) -> Policy:
        if metadata["command"] != COMMAND.to_json():
            raise ValueError("commands with another meaning")
        ranges = Bounds.from_json(metadata["ranges"], COMMAND.size, "ranges")
        for low, high in zip(ranges.low, ranges.high, strict=True):
            if not low < high:
                raise ValueError("ranges: wanted low below high for every command")
        observes_parameters = metadata.get("observes_parameters", True)
        if not isinstance(observes_parameters, bool):
            raise ValueError("observes_parameters: wanted true or false")
        widths = read_widths(metadata)
        return fresh_policy(emulator, ranges, widths, None, observes_parameters=observes_parameters)

    def _check(self, metadata: Metadata) -> None:
        if digest(emulator_tensors(self.emulator)) != metadata["emulator_sha256"]:
            raise ValueError("its emulator is not the one it was trained through")

    def _controls_near(self, states: Float[Array, "N S"]) -> Float[Array, "N C"]:
        """Return the controls in `states`, at all phases of the clock and with commands at both ends."""
        phases = jnp.linspace(0, 2 * math.pi, PROBED_STATES)
        ends = jnp.asarray([self.ranges.low, self.ranges.high], jnp.float32)
        commands = jnp.tile(ends, (PROBED_STATES // 2, 1))
        return jax.vmap(self.control)(self.emulator.encode(states), phases, commands)

    def _normalised(self, command: Float[Array, " 4"]) -> Float[Array, " 4"]:
        """Return the command scaled such that its ranges are ±1, and clipped to them."""
        middle = jnp.asarray(self.ranges.middle, jnp.float32)
        half = jnp.asarray(self.ranges.half, jnp.float32)
        return jnp.clip((command - middle) / half, -1, 1)

    def _streams(
        self, latent: Float[Array, " I"], phase: Float[Array, ""], command: Float[Array, " 4"]
    ) -> tuple[Float[Array, " O"], Float[Array, " E"]]:
        """Return the network's (odd, even) inputs of order one.

        They are the emulator's features of the body with controls in the middle, the clock's, and the `command`
        within ±1.
        """
        emulator = self.emulator
        relaxed = emulator.encode_control(jnp.asarray(emulator.bounds.middle, latent.dtype))
        features = emulator.domain.clip(emulator.raw_features(latent, relaxed))
        odd, even = emulator.features.streams(latent, emulator.normaliser.forward(features))
        if not self.observes_parameters:
            odd, even = _without_parameters(emulator, odd, even)
        clock = jnp.stack([jnp.sin(phase), jnp.cos(phase)])
        if not emulator.encoding.is_mirrored:
            return jnp.concatenate([odd, clock, command]), even
        no_clock = clock[:0]
        odd_clock, even_clock = (clock, no_clock) if self.rhythm.is_odd else (no_clock, clock)
        odd = jnp.concatenate([odd, odd_clock, command[ODD_COMMANDS]])
        even = jnp.concatenate([even, even_clock, command[EVEN_COMMANDS]])
        return odd, even


def latent_structure(emulator: Emulator) -> Structure:
    """Return the structure of latent states, as far as a pose needs it."""
    return Structure((), (), (), segments=emulator.frame.segments)


def _without_parameters(
    emulator: Emulator, odd: Float[Array, " O"], even: Float[Array, " E"]
) -> tuple[Float[Array, " _"], Float[Array, " _"]]:
    """Return (odd, even) of `Features.streams` without the parameters of a family's body."""
    features = emulator.features
    angles = features.angles.shape[0]
    parameters = emulator.shown_parameters
    if features.is_odd:
        kept = [i for i, shown in enumerate(features.even) if shown not in parameters]
        places = (*range(angles), *(angles + i for i in kept))
        return odd, reordered(even, places)
    first = 2 * angles
    places = tuple(i for i in range(odd.shape[0]) if i - first not in parameters)
    return reordered(odd, places), even


def fresh_policy(
    emulator: Emulator,
    ranges: Bounds,
    widths: tuple[int, ...],
    seed: int | None = 0,
    *,
    observes_parameters: bool = True,
) -> Policy:
    """Return an untrained policy, nearly the gait alone, with hidden layers of `widths`; without a seed its weights are zeros.

    Raises ArgumentError for a system without a heading.
    """
    key = None if seed is None else jax.random.key(seed)
    check_steerable(emulator)
    rhythm = Rhythm.from_emulator(emulator)
    size = emulator.control.size
    others = emulator.normaliser.plain_mean.shape[0] - len(emulator.features.plain)
    odd, even = emulator.features.sizes(others)
    hidden = 0 if observes_parameters else len(emulator.shown_parameters)
    if emulator.encoding.is_mirrored:
        even -= hidden
        odd += len(range(COMMAND.size)[ODD_COMMANDS])
        even += len(range(COMMAND.size)[EVEN_COMMANDS])
        if rhythm.is_odd:
            odd += CLOCK_SIZE
        else:
            even += CLOCK_SIZE
        even_out = tuple(range(emulator.encoding.odd_controls, size))
        network = make_network("mirrored", odd, even, size, widths, key, even_out)
    else:
        odd += CLOCK_SIZE + COMMAND.size - hidden
        network = make_network("linear-glu", odd, even, size, widths, key)
    return Policy(emulator, network, ranges, rhythm, observes_parameters)


def check_steerable(emulator: Emulator) -> None:
    """Raise ArgumentError for a soft body, and for a system without a heading."""
    if emulator.frame.shape_contacts is not None:
        raise ArgumentError(
            f"policy: {emulator.system} is a soft body, which goes where its movers go and has no heading to steer by. "
            "Find controls for it with 'control' or na.synthesise, or give its movers a path."
        )
    anywhere = np.zeros(emulator.encoding.layout.size)
    with np.errstate(all="ignore"):
        read_pose(latent_structure(emulator), anywhere)


def load_policy(name: str | Path) -> Policy:
    """Return the policy in the file `name`, or the shipped one of the system called `name`, such as `fish`.

    Every name, text, shape and number in the file is checked. Raises BadFileError with what is wrong with the
    file, or the list of shipped policies.
    """
    return read_policy_file(find_policy(str(name)), Policy)[0]
