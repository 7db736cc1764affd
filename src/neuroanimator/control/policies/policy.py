"""Policies: networks from a body's state and an abstract command to its muscles, forward(s, v) → u (SIGGRAPH 98).

A policy has the features of its emulator, so position and heading do not matter to it. A clock gives it the rhythm
of swimming; the system's gait is its initial guess. Mirrored inputs give mirrored controls.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.codegen.jax_settings import compiled_quickly
from neuroanimator.emulator.artifact import (
    FAULTS,
    check_arrays,
    check_format,
    first_line,
    shape_tensors,
    without_shapes,
)
from neuroanimator.emulator.description import FORMAT as EMULATOR_FORMAT
from neuroanimator.emulator.description import blank, describe
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.features import reordered
from neuroanimator.emulator.networks import MAX_LAYER, make_network
from neuroanimator.emulator.networks.network import Network, prefixed
from neuroanimator.emulator.tensors import (
    emulator_leaves,
    emulator_tensors,
    to_numpy,
    with_tensors,
)
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import Metadata, Tensors, digest, read_tensors, write_tensors
from neuroanimator.files.numbers import listed, whole
from neuroanimator.files.zoo import find_policy
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.pose import Pose, read_pose
from neuroanimator.state.structure import Structure

FORMAT = 2
"""Version of the file format, raised whenever an older reader would misunderstand a file."""

KIND = "policy"

PROBED_STATES = 8
"""Number of states in which a policy's controls are looked at when it is loaded: rest, and others near it."""

PROBED_SPREAD = 0.1
"""Standard deviation of these states around rest [their units]."""

MAKER = "train_policy"
"""Function that retrains policies that are too old to be read."""

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


class Policy(eqx.Module):
    """u = middle + half · tanh(idle + waves of the gait + network(features of the body, clock, command))."""

    emulator: Emulator
    """Emulator it was trained through, whose features it has."""
    network: Network
    ranges: Bounds = eqx.field(static=True)
    """Range of each command in training, in the order of `COMMAND`."""
    rhythm: Rhythm = eqx.field(static=True)
    observes_parameters: bool = eqx.field(static=True, default=True)
    """Whether the network gets the parameters of a family's body; if not, it is robust against them at best."""

    def __repr__(self) -> str:
        spec = self.emulator.spec
        return f'Policy("{spec.system}", dt {self.dt:g} s, {spec.control.size} controls)'

    @property
    def dt(self) -> float:
        """Time for which a control is held [s]."""
        return self.emulator.dt

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
        middle = jnp.asarray(bounds.middle, jnp.float32)
        half = jnp.asarray(bounds.half, jnp.float32)
        raw = steered + waves
        if (
            emulator.skeleton.shapes is not None
        ):  # muscles of flesh only pull: by themselves they are nearly idle
            share = (bounds.idle - bounds.middle) / bounds.half
            raw = raw + np.arctanh(np.clip(share, -NEARLY_IDLE, NEARLY_IDLE))
        return middle + half * jnp.tanh(raw)

    def pose(self, latent: Float[AnyArray, "*B I"]) -> Pose:
        """Return the poses of bodies in the latent states `latent` of `Emulator.encode`."""
        return read_pose(latent_structure(self.emulator), latent)

    def save(self, path: str | Path) -> None:
        """Write the policy, its emulator included, as one `.safetensors` file."""
        save_policy(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Policy:
        """Return the policy in the file at `path`, or the shipped one of that name, such as `fish`.

        Raises BadFileError with what is wrong with the file, or the list of names.
        """
        return load_policy(path)

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
    seed: int = 0,
    *,
    observes_parameters: bool = True,
) -> Policy:
    """Return an untrained policy, nearly the gait alone, with hidden layers of `widths`.

    Raises ArgumentError for a system without a heading.
    """
    key = jax.random.key(seed)
    return make_policy(emulator, ranges, widths, key, observes_parameters=observes_parameters)


def make_policy(
    emulator: Emulator,
    ranges: Bounds,
    widths: tuple[int, ...],
    key: PRNGKeyArray | None,
    *,
    observes_parameters: bool = True,
) -> Policy:
    """Return `fresh_policy` with a random key; without one its weights are zeros."""
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


def save_policy(policy: Policy, path: Path, provenance: dict[str, Any] | None = None) -> None:
    """Write `policy` to `path`; `provenance` states how it was trained (any JSON)."""
    metadata = describe_policy(policy) | {"provenance": provenance or {}}
    tensors = to_numpy(policy_leaves(policy)) | shape_tensors(policy.emulator)
    write_tensors(path, tensors, metadata)


def policy_leaves(policy: Policy) -> dict[str, Any]:
    """Return every array of `policy` by its name in files."""
    emulator = prefixed("emulator", emulator_leaves(policy.emulator))
    return emulator | prefixed("network", policy.network.leaves())


def describe_policy(policy: Policy) -> dict[str, Any]:
    """Return the metadata that, together with the tensors, makes up the policy."""
    described = {
        "kind": KIND,
        "format": FORMAT,
        "emulator": describe(policy.emulator),
        "emulator_sha256": digest(emulator_tensors(policy.emulator)),
        "command": COMMAND.to_json(),
        "ranges": [list(policy.ranges.low), list(policy.ranges.high)],
        "widths": list(policy.network.widths),
    }
    # Older readers, which do not know such policies, refuse them: they have fewer weights.
    if not policy.observes_parameters:
        described["observes_parameters"] = False
    return described


def load_policy(name: str | Path) -> Policy:
    """Return the policy in the file `name`, or the shipped one of the system called `name`, such as `fish`.

    Every name, text, shape and number in the file is checked. Raises BadFileError with what is wrong with the
    file, or the list of shipped policies.
    """
    path = find_policy(str(name))
    return policy_from(path, *read_tensors(path, KIND))


def policy_from(path: Path, tensors: Tensors, metadata: Metadata) -> Policy:
    """Return the policy read from the file at `path`; BadFileError states what is wrong with it."""
    check_policy_formats(path, metadata, FORMAT, MAKER)
    try:
        weights, shapes = without_shapes(tensors)
        policy = with_tensors(blank_policy(metadata, shapes), policy_leaves, weights)
        if digest(emulator_tensors(policy.emulator)) != metadata["emulator_sha256"]:
            raise ValueError("its emulator is not the one it was trained through")
        check_arrays(policy.emulator)
        check_controls(policy, _controls_near)
        return policy
    except FAULTS as error:
        raise BadFileError(
            f"{path} is not a usable policy: {first_line(error)}. Make it again."
        ) from error


def check_controls(
    policy: Any, controls_near: Callable[[Any, Float[Array, "N S"]], Float[Array, "N C"]]
) -> None:
    """Refuse a policy whose controls are not finite in states near rest; raises ValueError.

    `controls_near` gives its controls in some states (N, S).
    """
    rest = np.asarray(policy.emulator.rest, np.float32)
    rng = np.random.default_rng(0)
    offsets = rng.normal(size=(PROBED_STATES, len(rest))) * PROBED_SPREAD
    offsets[0] = 0
    states = jnp.asarray(rest + offsets, jnp.float32)
    controls = np.asarray(compiled_quickly(controls_near)(policy, states))
    if not np.isfinite(controls).all():
        raise ValueError("its controls are not finite numbers")


def _controls_near(policy: Policy, states: Float[Array, "N S"]) -> Float[Array, "N C"]:
    """Return the controls in `states` (N, S), at all phases of the clock and with commands at both ends."""
    phases = jnp.linspace(0, 2 * math.pi, PROBED_STATES)
    ends = jnp.asarray([policy.ranges.low, policy.ranges.high], jnp.float32)
    commands = jnp.tile(ends, (PROBED_STATES // 2, 1))
    return jax.vmap(policy.control)(policy.emulator.encode(states), phases, commands)


def check_policy_formats(path: Path, metadata: Metadata, wanted: int, maker: str) -> None:
    """Refuse a policy's file of another format than `wanted`, or with an emulator of another format; `maker` makes it again."""
    check_format(path, metadata.get("format"), wanted, maker)
    emulator = metadata.get("emulator")
    emulator_format = emulator.get("format") if isinstance(emulator, dict) else None
    check_format(path, emulator_format, EMULATOR_FORMAT, maker)


def blank_policy(metadata: Metadata, shapes: Tensors) -> Policy:
    """Return a policy of the described structure with zero weights; `shapes` are the arrays of a soft body's shapes."""
    if metadata["command"] != COMMAND.to_json():
        raise ValueError("commands with another meaning")
    ranges = Bounds.from_json(metadata["ranges"], COMMAND.size, "ranges")
    for low, high in zip(ranges.low, ranges.high, strict=True):
        if not low < high:
            raise ValueError("ranges: wanted low below high for every command")
    widths = listed(metadata["widths"], "widths", checked_width)
    observes_parameters = metadata.get("observes_parameters", True)
    if not isinstance(observes_parameters, bool):
        raise ValueError("observes_parameters: wanted true or false")
    emulator = blank(metadata["emulator"], Emulator, shapes)
    return make_policy(emulator, ranges, widths, None, observes_parameters=observes_parameters)


def checked_width(width: Any, label: str) -> int:
    """Return the size of a hidden layer; ValueError if it is invalid."""
    return whole(width, label, 1, MAX_LAYER)
