"""Whether an emulator stays in the range of training, and at rest, while its controls are held.

Errors of one super step, and motions under random controls, do not show that a body runs away under controls that stay.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.domain import MARGIN
from neuroanimator.state.layout import Bounds
from neuroanimator.text import short_number

if TYPE_CHECKING:
    from neuroanimator.emulator.emulator import Emulator

STEPS = 2000
"""Default number of super steps: enough to reach every steady state, and less than a second of computing."""

MAX_CORNERS = 64
"""Maximum number of corners of the controls' box that are all tried: those of six controls."""

RANDOM_CORNERS = 16
"""Number of random corners tried for more controls, besides each control alone at both ends."""

BLOCK = 500
"""Number of super steps rolled out at once."""

EVERY = 10
"""Number of super steps between two states that are looked at: what leaves stays away for longer."""

FAR = 2.0
"""Number of ranges beyond its own that a number may get. Numbers seen one by one are kept within 0.1 and velocities along an
axis within 1.3; the rest follows from what is kept."""

STILL = 1e-3
"""Maximum change in the first super step from rest of an emulator that keeps still [the usual change]."""

CREPT = 1.0
"""Distance from rest at which an emulator that keeps still has crept away [the usual change in a super step]."""


@dataclass(frozen=True)
class Departure:
    """A number that leaves its range of training, or rest, while controls are held."""

    quantity: str
    control: tuple[float, ...]
    """The control that is held (C,)."""
    seconds: float
    """Time after which it has left [s]."""
    excess: float
    """Largest distance from the range [its width]; of the state of rest, from rest [usual changes]; infinite if not finite."""

    def __str__(self) -> str:
        """Return it as half a sentence."""
        held = ", ".join(f"{value:.4g}" for value in self.control)
        return (
            f"with the controls held at ({held}) {self.quantity} leaves training after "
            f"{short_number(self.seconds)} s"
        )


def held_controls(bounds: Bounds) -> Float[np.ndarray, "B C"]:
    """Return the controls that are held: the corners of their box, or some of many, and at last the idle ones."""
    low = np.array(bounds.low)
    high = np.array(bounds.high)
    size = len(low)
    idle = np.asarray(bounds.idle, float)
    if 2**size <= MAX_CORNERS:
        corners = np.array(list(itertools.product(*zip(low, high, strict=True)))).reshape(
            2**size, size
        )
        return np.concatenate([corners, idle[None]])
    alone = np.repeat(idle[None], 2 * size, axis=0)
    alone[np.arange(size), np.arange(size)] = low
    alone[size + np.arange(size), np.arange(size)] = high
    signs = np.random.default_rng(0).random((RANDOM_CORNERS, size))
    return np.concatenate([alone, np.where(signs < 0.5, low, high), [low, high, idle]])


def find_departures(emulator: Emulator, steps: int = STEPS) -> list[Departure]:
    """Return what leaves training in `steps` super steps from rest under each of the `held_controls`, worst first.

    Every quantity is named once, with the controls under which it gets furthest.
    """
    held = held_controls(emulator.bounds).astype(np.float32)
    names = _judged_names(emulator)
    states = np.repeat(np.asarray(emulator.rest, np.float32)[None], len(held), axis=0)
    keeps_still = False
    furthest = np.zeros((len(held), len(names)))
    left_at = np.full(furthest.shape, np.inf)
    for done in range(0, steps, BLOCK):
        length = min(BLOCK, steps - done)
        controls = np.repeat(held[:, None], length, axis=1)
        path = np.asarray(emulator.rollout(states, controls, may_diverge=True))
        if not done:
            # Not by a step of its own, which would be another program.
            keeps_still = _from_rest(emulator, path[-1, 1:2])[0] <= STILL
        looked_at = np.append(np.arange(EVERY, length, EVERY), length)
        excess = _excess(emulator, path[:, looked_at], controls[:, looked_at - 1])
        if keeps_still:
            excess[-1, :, -1] = FAR / CREPT * _from_rest(emulator, path[-1, looked_at])
        furthest = np.maximum(furthest, excess.max(axis=1))
        is_out = excess > FAR
        first = np.where(is_out.any(axis=1), done + looked_at[is_out.argmax(axis=1)], np.inf)
        left_at = np.minimum(left_at, first)
        states = path[:, -1]
        if not np.isfinite(states).all():
            break
    worst: dict[str, Departure] = {}
    for row, column in zip(*np.nonzero(furthest > FAR), strict=True):
        found = Departure(
            quantity=names[column],
            control=tuple(held[row].tolist()),
            seconds=float(left_at[row, column] * emulator.dt),
            excess=float(furthest[row, column]),
        )
        known = worst.setdefault(found.quantity, found)
        if found.excess > known.excess:
            worst[found.quantity] = found
    return sorted(worst.values(), key=lambda departure: -departure.excess)


def departures_in_words(departures: Sequence[Departure]) -> str:
    """Return the worst of the `departures` found in `STEPS` super steps as half a sentence, or that there are none."""
    if not departures:
        return f"for {STEPS:,} super steps at the controls' bounds, and at rest, it stays within training"
    told = str(departures[0])
    if len(departures) > 1:
        told += f", and so do {len(departures) - 1} more numbers"
    return told


def _judged_names(emulator: Emulator) -> list[str]:
    """Return the names of the raw features, and of what else is judged: the state of rest."""
    entries = emulator.encoding.layout.names
    names = [entries[entry] for entry in emulator.features.plain]
    names += emulator.frame.local_names
    names += ["a control"] * (len(emulator.domain.low) - len(names))
    return [*names, "the state of rest"]


def _excess(
    emulator: Emulator, path: Float[np.ndarray, "B T S"], controls: Float[np.ndarray, "B T C"]
) -> Float[np.ndarray, "B T Q"]:
    """Return how far the features of a path lie beyond their ranges, in these; 0 for the state of rest.

    Of a body in few numbers, the shape is kept as a whole, so that its single modes do not matter.
    """
    low = np.asarray(emulator.domain.low, float)
    high = np.asarray(emulator.domain.high, float)
    features = np.asarray(emulator.raw_features_of(path, controls), float)
    beyond = np.maximum(np.maximum(low - features, features - high), 0)
    excess = beyond / (np.asarray(emulator.domain.margin, float) / MARGIN)
    if not emulator.encoding.keeps_entries:
        entries = emulator.encoding.layout.index("modes")
        is_mode = [entries.start <= entry < entries.stop for entry in emulator.features.plain]
        excess[..., np.flatnonzero(is_mode)] = 0
    excess[~np.isfinite(features)] = np.inf
    return np.concatenate([excess, np.zeros_like(excess[..., :1])], axis=-1)


def _from_rest(emulator: Emulator, states: Float[np.ndarray, "T S"]) -> Float[np.ndarray, " T"]:
    """Return the largest difference of `states` (T, S) from rest, in usual changes of a super step."""
    latent = np.asarray(emulator.encode(np.asarray(states, float)))
    rest = np.asarray(emulator.encode(np.asarray(emulator.rest, float)))
    unit = np.asarray(emulator.normaliser.unit, float)
    moves = unit > 0
    difference = np.asarray(emulator.frame.difference(rest[None], latent))
    return np.abs(difference[:, moves] / unit[moves]).max(axis=1)
