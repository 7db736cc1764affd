"""The super steps of pendulum and fish written in C by hand: what generated C is measured against, as the limit.

Both are what a programmer writes who knows the architecture and compilers: sums in registers, sizes known when C compiles,
weights laid out for it. They read the emulators' own weights, are compiled with the flags of generated C, and are timed only
after a rollout agrees with JAX.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from neuroanimator import Emulator
from neuroanimator.codegen.compiler import compiled_library
from neuroanimator.codegen.kept import FLAGS, address, aligned, declared
from neuroanimator.codegen.program import WIDTH
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.encoding import KEPT_MARGIN
from neuroanimator.emulator.networks.gated import Gated
from neuroanimator.emulator.networks.mirrored import Mirrored
from neuroanimator.emulator.shape_modes import ShapeModes
from neuroanimator.errors import ResourceError
from neuroanimator.state.structure import mixing

HERE = Path(__file__).parent

TOLERANCE = 1e-3
"""Of the largest number of a state: how far a rollout may be from the one in JAX, for roundings add up."""

CHECKED_MOTIONS = 25
CHECKED_STEPS = 40
"""A thousand super steps in all, under controls up to their bounds."""

Numbers = Mapping[str, float]
"""What is defined before a program's text."""

Weights = list[np.ndarray]


@dataclass(frozen=True)
class ByHand:
    """An emulator's rollouts in C written by hand."""

    library: ctypes.CDLL
    weights: Weights
    table: Any
    """Where each of the weights lies."""
    state_size: int

    def rollout(
        self, latent: Float[np.ndarray, " I"], controls: Float[np.ndarray, "T C"]
    ) -> Float[np.ndarray, "T S"]:
        """Return the states after each super step from the `latent` start."""
        states = np.empty((len(controls), self.state_size), np.float32)
        arrays = (address(controls), len(controls), address(states))
        self.library.rollout(self.table, address(latent), *arrays)
        return states


def written_by_hand(emulator: Emulator) -> ByHand | None:
    """Return the program of `emulator`, held against JAX; None for those that nobody has written.

    Raises ResourceError where it does not do what JAX does.
    """
    programs = {"pendulum": _pendulum, "fish": _fish}
    if emulator.system not in programs or emulator.strides != 1:
        return None
    defines, weights = programs[emulator.system](emulator)
    lines = [f"#define {name} {_literal(number)}" for name, number in defines.items()]
    parts = [(HERE / name).read_text() for name in ("common.h", f"{emulator.system}.c")]
    library = compiled_library("\n".join([*lines, *parts]), FLAGS)
    if library is None:
        raise ResourceError("runtimes: C written by hand needs a C compiler.")
    declared(library, "rollout", 5, None)
    kept = [_aligned(array) for array in weights]
    table = (ctypes.c_void_p * len(kept))(*map(address, kept))
    program = ByHand(library, kept, table, emulator.state.size)
    _check(emulator, program)
    return program


def _check(emulator: Emulator, program: ByHand) -> None:
    """Raise ResourceError unless a rollout from each of some random starts is the one of JAX."""
    rng = np.random.default_rng(1)
    shape = (CHECKED_STEPS, emulator.control.size)
    for _ in range(CHECKED_MOTIONS):
        shares = rng.uniform(-1, 1, shape)
        controls = as_float32(emulator.bounds.middle + shares * emulator.bounds.half)
        latent = as_float32(emulator.encode(emulator.rest))
        expected = np.asarray(emulator.rollout(jnp.asarray(emulator.rest), jnp.asarray(controls)))[
            1:
        ]
        scale = np.abs(expected).max(axis=0) + 1e-3
        off = float((np.abs(program.rollout(latent, controls) - expected) / scale).max())
        if not off <= TOLERANCE:
            raise ResourceError(f"runtimes: {emulator.system} by hand is {off:.2g} off.")


def _literal(number: float) -> str:
    return f"{number!r}f" if isinstance(number, float) else str(number)


def _pendulum(emulator: Emulator) -> tuple[Numbers, Weights]:
    network = emulator.network
    assert isinstance(network, Gated)
    first, second = network.layers
    normaliser = emulator.normaliser
    kept = emulator.domain.widened(KEPT_MARGIN, slice(len(emulator.features.plain)))
    angles = np.asarray(emulator.features.angles)
    defines = {
        "STATE": emulator.state.size,
        "CONTROL": emulator.control.size,
        "ANGLES": len(angles),
        "HALF0": first.bias.shape[0] // 2,
        "HALF1": second.bias.shape[0] // 2,
    }
    weights = [
        _padded(angles.T),
        emulator.domain.low,
        emulator.domain.high,
        normaliser.plain_mean,
        1 / np.asarray(normaliser.plain_scale),
        *map(_padded, (first.odd_in, first.even_in, first.bias)),
        *map(_padded, (second.odd_in, second.even_in, second.bias, network.out)),
        normaliser.change_mean,
        normaliser.change_scale,
        *kept,
    ]
    return defines, weights


def _fish(emulator: Emulator) -> tuple[Numbers, Weights]:
    network, modes, normaliser = emulator.network, emulator.encoding, emulator.normaliser
    assert isinstance(network, Mirrored)
    assert isinstance(modes, ShapeModes)
    assert modes.mirror is not None
    (layer,) = network.layers
    features = len(normaliser.plain_mean)
    even = emulator.features.even
    odd = np.array([i for i in range(features) if i not in even])
    # What fills a vector up is some number that no weight is for.
    order = np.concatenate(
        [np.resize(group, len(group) + _padding(len(group))) for group in (odd, np.array(even))]
    )
    scale = 1 / np.asarray(normaliser.plain_scale)
    size, position_modes = modes.positions.shape
    odd_answers = network.odd_out.shape[1]
    even_answers = network.even_out.shape[1]
    answers = np.array(network._order())
    answers[answers >= odd_answers] += _padding(odd_answers)

    def by_axis(array: Any) -> Float[np.ndarray, ...]:
        """Return (..., 3 N) as (..., 3, N), each axis padded, in one row."""
        points = np.asarray(array).reshape(*np.shape(array)[:-1], -1, 3)
        rows = _padded(np.moveaxis(points, -1, -2))
        return rows.reshape(*rows.shape[:-2], -1)

    mixed = mixing(modes.mirror.controls)[0]
    is_position = modes.is_position_mode()
    spread = np.asarray(modes.spread)
    defines = {
        "CONTROL": emulator.control.size,
        "MODE_COUNT": modes.count,
        "POSITION_MODES": position_modes,
        "ODD_POSITIONS": modes.odd_positions,
        "ODD_VELOCITIES": modes.odd_velocities,
        "EVEN_VELOCITIES": modes.velocities.shape[1] - modes.odd_velocities,
        "FEATURES": features,
        "ODD_FEATURES": features - len(even),
        "HALF": layer.bias.shape[0] // 2,
        "ODD_ANSWERS": odd_answers,
        "EVEN_ANSWERS": even_answers,
        "CHANGES": odd_answers + even_answers,
        "POINTS": size // 3,
        "POINTS3": size,
        "DT": float(emulator.dt),
        "LEFT": math.exp(-emulator.dt / modes.time_constant),
    }
    weights = [
        _padded(mixed),
        _padded(mixed.T),
        order.astype(np.int32),
        *(np.asarray(array)[order] for array in (emulator.domain.low, emulator.domain.high)),
        np.asarray(normaliser.plain_mean)[order],
        scale[order],
        *map(_padded, (layer.odd_in, layer.even_in, layer.bias, network.odd_out, network.even_out)),
        *map(_padded, (network.odd_linear, network.even_linear)),
        answers.astype(np.int32),
        normaliser.change_mean,
        normaliser.change_scale,
        1 / np.concatenate([spread[is_position], spread[~is_position]]),
        modes.limits,
        *(by_axis(np.asarray(array).T) for array in (modes.positions, modes.velocities)),
        *map(by_axis, (modes.mean_position, modes.mean_velocity)),
    ]
    return defines, weights


def _padding(columns: int) -> int:
    return -columns % WIDTH


def _padded(matrix: Any) -> Float[np.ndarray, ...]:
    """Return a matrix or a vector whose rows are whole vectors of `WIDTH` numbers, zeros at their ends."""
    array = np.asarray(matrix, np.float32)
    spare = [(0, 0)] * (array.ndim - 1) + [(0, _padding(array.shape[-1]))]
    return np.pad(array, spare)


def _aligned(array: Any) -> np.ndarray:
    """Return the numbers one after another, aligned for the widest register; whole ones keep their bits."""
    flat = np.asarray(array).ravel()
    if flat.dtype == np.int32:
        return aligned(flat.view(np.float32))
    return aligned(flat.astype(np.float32))
