"""Policies: from what a body feels and an abstract command to its muscles, forward(s, v) → u (SIGGRAPH 98).

A policy sees what its emulator sees, so place and heading do not matter to it. A clock gives it the rhythm
to swim by; the system's gait is its first guess. Whatever is mirrored in, comes out mirrored.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks import make_network
from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.pca import mixing
from neuroanimator.state.layout import Bounds, Layout, Slice
from neuroanimator.state.pose import Pose, read_pose
from neuroanimator.state.rotation import Numbers
from neuroanimator.state.structure import Structure
from neuroanimator.zoo import find_policy

COMMAND = Layout(
    (
        Slice("speed", 1, "m/s"),
        Slice("turn", 1, "rad"),
        Slice("climb", 1, "rad"),
        Slice("roll", 1, "rad"),
    )
)
"""Forward speed; how far still to turn left, to pitch up and to roll over to the right, as seen from the body."""

# The mirror reverses every second one: turn and roll.

USUAL_PERIOD = 1.0
"""[s] Of the clock where no gait says one."""


class Rhythm(NamedTuple):
    """The waves a clock gives to the muscles: amplitude · sin(phase - lag), full at the highest speed."""

    period: float
    """[s]"""
    amplitudes: tuple[float, ...]
    """(C,) of each control."""
    lags: tuple[float, ...]
    """(C,) [rad]"""
    is_odd: bool
    """Whether left and right take turns, so that half a period later is the mirror's image."""

    @classmethod
    def of(cls, emulator: Emulator) -> Rhythm:
        """Return the rhythm of the emulator's gait; without one, a clock alone."""
        gait, size = emulator.spec.gait, emulator.spec.control.size
        if gait is None:
            return cls(USUAL_PERIOD, (0.0,) * size, (0.0,) * size, False)
        odd = odd_controls(emulator)
        waves = np.array(gait.amplitudes) * np.exp(-1j * np.array(gait.lags))
        sizes = np.abs(
            np.stack([emulator.encode_control(part) for part in (waves.real, waves.imag)])
        )
        return cls(
            gait.period,
            gait.amplitudes,
            gait.lags,
            bool(sizes[:, :odd].sum() > sizes[:, odd:].sum()),
        )


class Policy(eqx.Module):
    """u = middle + half · tanh(waves of the gait + network(what the body feels, clock, command))."""

    emulator: Emulator
    """The one it was trained through: it feels what that sees."""
    network: Network
    ranges: Bounds = eqx.field(static=True)
    """Of the commands it was trained on, in the order of `COMMAND`."""
    rhythm: Rhythm = eqx.field(static=True)

    def __repr__(self) -> str:
        spec = self.emulator.spec
        return f'Policy("{spec.system}", dt {self.dt:g} s, {spec.control.size} controls)'

    @property
    def dt(self) -> float:
        """Time a control is held [s]."""
        return self.emulator.dt

    @property
    def tick(self) -> float:
        """What the clock's phase gains in one super step [rad]."""
        return 2 * math.pi * self.dt / self.rhythm.period

    def control(
        self, latent: Float[Array, " I"], phase: Float[Array, ""], command: Float[Array, " 4"]
    ) -> Float[Array, " C"]:
        """Return the control for a body that feels `latent` (see `Emulator.encode`) at `phase` [rad] of the clock.

        Commands out of range count as the nearest in range. Differentiable, unchecked: for use inside jit.
        """
        wish, bounds = self._wish(command), self.emulator.spec.bounds
        numbers = self.network(*self._streams(latent, phase, wish))
        steered = (
            numbers if self.emulator.modes is None else self.emulator.modes.decode_control(numbers)
        )
        lags, amplitudes = (
            jnp.asarray(each) for each in (self.rhythm.lags, self.rhythm.amplitudes)
        )
        waves = amplitudes * jnp.sin(phase + self.tick / 2 - lags) * (wish[0] + 1) / 2
        middle, half = (jnp.asarray(each, jnp.float32) for each in (bounds.middle, bounds.half))
        return middle + half * jnp.tanh(steered + waves)

    def pose(self, latent: Numbers) -> Pose:
        """Return where bodies are and where they point, of `latent` (..., I) as `Emulator.encode` gives it."""
        return read_pose(structure_of(self.emulator), latent)

    def save(self, path: str | Path) -> None:
        """Write the policy, its emulator included, as one `.safetensors` file."""
        from neuroanimator.control.policies.policy_file import save_policy

        save_policy(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Policy:
        """Return the policy in the file at `path`, or the shipped one of that name, such as `fish`.

        BadFileError says what is wrong with the file, or which names there are.
        """
        return load_policy(path)

    def _wish(self, command: Float[Array, " 4"]) -> Float[Array, " 4"]:
        """Return the command within ±1."""
        middle, half = (
            jnp.asarray(each, jnp.float32) for each in (self.ranges.middle, self.ranges.half)
        )
        return jnp.clip((command - middle) / half, -1, 1)

    def _streams(self, latent: Array, phase: Array, wish: Array) -> tuple[Array, Array]:
        """Return (odd, even) numbers of order one: of the body, its muscles' controls relaxed, clock and command."""
        emulator = self.emulator
        relaxed = emulator.encode_control(jnp.asarray(emulator.spec.bounds.middle, latent.dtype))
        plain = emulator.normaliser.forward(emulator.domain.clip(emulator.seen(latent, relaxed)))
        odd, even = emulator.features.streams(latent, plain)
        clock = jnp.stack([jnp.sin(phase), jnp.cos(phase)])
        if not is_mirrored(emulator):
            return jnp.concatenate([odd, clock, wish]), even
        odd_clock, even_clock = (clock, clock[:0]) if self.rhythm.is_odd else (clock[:0], clock)
        return jnp.concatenate([odd, odd_clock, wish[1::2]]), jnp.concatenate(
            [even, even_clock, wish[::2]]
        )


def load_policy(name: str | Path) -> Policy:
    """Return the policy in the file `name`, or the shipped one of the system called `name`, such as `fish`.

    Raises BadFileError, which says what is wrong with the file, or which policies ship.
    """
    from neuroanimator.control.policies import policy_file

    return policy_file.load_policy(find_policy(str(name)))


def structure_of(emulator: Emulator) -> Structure:
    """Return the structure of `Emulator.encode`'s numbers, as far as a pose needs it."""
    return Structure((), (), (), segments=emulator.frame.segments)


def is_mirrored(emulator: Emulator) -> bool:
    """Return whether the body has a left and a right that are alike."""
    return emulator.modes is not None and emulator.modes.mirror is not None


def odd_controls(emulator: Emulator) -> int:
    """Return how many of the mixed controls, the first ones, the mirror reverses."""
    modes = emulator.modes
    return 0 if modes is None or modes.mirror is None else mixing(modes.mirror)[1]


def fresh_policy(
    emulator: Emulator, ranges: Bounds, widths: tuple[int, ...], seed: int = 0
) -> Policy:
    """Return an untrained policy, nearly the gait alone.

    Raises ArgumentError for a system that cannot point anywhere.
    """
    rhythm, size = Rhythm.of(emulator), emulator.spec.control.size
    read_pose(structure_of(emulator), emulator.encode(jnp.asarray(emulator.spec.rest)))
    key, others = (
        jax.random.key(seed),
        emulator.normaliser.plain_mean.shape[0] - len(emulator.features.plain),
    )
    odd, even = emulator.features.sizes(others)
    kind = "mirrored" if is_mirrored(emulator) else "linear-glu"
    if kind == "mirrored":
        odd, even = odd + 2 + 2 * rhythm.is_odd, even + 2 + 2 * (not rhythm.is_odd)
    else:
        odd += 2 + COMMAND.size
    even_out = tuple(range(odd_controls(emulator), size)) if kind == "mirrored" else ()
    return Policy(
        emulator, make_network(kind, odd, even, size, widths, key, even_out), ranges, rhythm
    )
