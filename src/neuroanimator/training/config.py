"""Configuration of a training: every choice the resulting weights depend on, besides the data."""

from __future__ import annotations

import hashlib
import math
import re
from typing import Any, Literal

from pydantic import Field, field_validator

from neuroanimator.data.config import MAX_UNROLL
from neuroanimator.data.stored import DEFAULT_MEMORY
from neuroanimator.emulator.networks import DEFAULT_WIDTHS, check_widths
from neuroanimator.errors import ArgumentError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.files.tables import Settings
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import LONG_WINDOW
from neuroanimator.text import quoted

UPDATES_PER_CHUNK = 250
"""Updates compiled into one call: long enough to hide the call, short enough for a lively progress bar."""

LARGE_BATCHES: dict[str, Any] = {
    "batch": 2048,
    "learning_rate": 1e-2,
    "orthogonalisation_steps": 3,
}
"""Settings that suit bodies with contacts, together or not at all. In the time of as many updates of a quarter of the
batch, errors of a walking robot are a tenth smaller."""

ON_GROUND = LARGE_BATCHES | {"widths": (256, 192), "updates": 16_000}
"""Bodies that may touch the ground: with half as many units errors of a walking robot are a fifth larger."""

WITH_STOPS = LARGE_BATCHES | {"widths": (128, 96), "updates": 32_000}
"""Bodies whose joints have stops, and that touch nothing: narrower layers have time for more updates."""

SOFT: dict[str, Any] = {
    "network": "linear-glu",
    "widths": (256, 256),
    "batch": 2048,
    "orthogonalisation_steps": 3,
    "updates": 8_000,
    "unroll": LONG_WINDOW,
    "unroll_share": 0.6,
    "error_growth": 1.0,
}
"""Soft bodies: they are damped, so that errors grow slowly at last, and what they are off by then is what counts."""

MIN_MEMORY = 16 * 10**6
"""With less, not even one shard of the smallest system would fit [bytes]."""

MAX_MEMORY = 10**15
"""More is a slip of the hand [bytes]."""

SIZE_UNITS = {"kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}

SIZE = re.compile(r"([0-9]{1,12}(?:\.[0-9]{1,6})?) ?(kB|MB|GB|TB)", re.ASCII)

DEFAULT_RATES = {"muon": 5e-3, "adam": 5e-3, "momentum": 2e-2}


def _suited(structure: Structure) -> dict[str, Any]:
    """Return the settings that suit states of this `structure`, where they are not everybody's."""
    if structure.shape_contacts is not None:
        return SOFT
    if structure.contacts is None:
        return {}
    return ON_GROUND if structure.contacts.points else WITH_STOPS


class TrainingConfig(Settings):
    """A training run: single super steps first, then a share of updates unrolled over several.

    Raises ArgumentError naming the field that is wrong.
    """

    network: Literal["gated", "classic", "glu", "linear-glu", "mirrored", "hierarchy"] = "gated"
    widths: tuple[int, ...] = Field(default=(), validate_default=True)
    """Units in each hidden layer; the network's usual ones if empty."""
    optimizer: Literal["muon", "adam", "momentum"] = "muon"
    learning_rate: float = Field(
        default=0.0, ge=0, lt=10, allow_inf_nan=False, validate_default=True
    )
    """The highest; the optimiser's usual one if 0."""
    orthogonalisation_steps: int = Field(default=5, ge=1, le=10)
    """Number of Newton-Schulz iterations by which Muon orthogonalises an update's matrix: it takes most of the time
    that wide layers take."""
    updates: int = Field(default=40_000, ge=UPDATES_PER_CHUNK, le=10_000_000)
    batch: int = Field(default=512, ge=4, le=65_536)
    rare_share: float = Field(default=0.0, ge=0, lt=1)
    """Share of each batch drawn among the tenth of all windows with the most unusual changes, such as touchdowns."""
    position_modes: int = Field(default=0, ge=0, le=256)
    """Shapes a deformable body is made of, and ways its parts move; 0: as many as matter. See `shape_modes`."""
    velocity_modes: int = Field(default=0, ge=0, le=256)
    local_modes: int = Field(default=4, ge=1, le=64)
    """The same per segment, besides where it is; of hierarchies."""
    unroll: int = Field(default=MAX_UNROLL, ge=1, le=LONG_WINDOW)
    unroll_share: float = Field(default=0.2, ge=0, le=1)
    error_growth: float = Field(default=2.0, ge=0, le=4)
    """Power of the number of super steps by which squared errors are expected to grow: the loss divides them by it."""
    calm: float = Field(default=0.0, ge=0, le=1e3)
    """Mean square change in a super step, over the usual one, from which on a window counts less the more it changes, and below
    which all count alike; 0: all count alike, so that fast motion, whose changes and errors are large, is most of the loss.
    Windows of soft bodies that move freely are weighed by their errors instead."""
    validation_share: float = Field(default=0.05, gt=0, lt=0.9)
    patience: int = Field(default=80, ge=1)
    seed: int = Field(default=0, ge=0, lt=2**31)
    memory: int = Field(default=DEFAULT_MEMORY, ge=MIN_MEMORY, le=MAX_MEMORY)
    """Maximum memory of windows, besides the program itself [bytes], or text such as `1GB`. A dataset that takes more stays on
    disk, and its windows come in another order; of one that fits nothing depends on this."""

    @field_validator("memory", mode="before")
    @classmethod
    def _bytes_of(cls, memory: Any) -> Any:
        if not isinstance(memory, str):
            return memory
        match = SIZE.fullmatch(memory)
        if match is None:
            raise ArgumentError(
                f"memory: wanted a size such as 500MB, 8GB or 1.5TB; came {quoted(memory)}."
            )
        return round(float(match[1]) * SIZE_UNITS[match[2]])

    @field_validator("widths")
    @classmethod
    def _usual_widths(cls, widths: tuple[int, ...], info: Any) -> tuple[int, ...]:
        network = info.data.get("network", "")
        return widths or DEFAULT_WIDTHS.get(network, ())

    @field_validator("learning_rate")
    @classmethod
    def _usual_rate(cls, rate: float, info: Any) -> float:
        optimizer = info.data.get("optimizer", "")
        return rate or DEFAULT_RATES.get(optimizer, rate)

    @classmethod
    def usual(cls, structure: Structure, **settings: Any) -> TrainingConfig:
        """Return how states of this `structure` are learnt if nothing but `settings` is said."""
        is_usual = settings.get("network", "gated") in ("gated", "glu")
        is_usual &= settings.get("optimizer", "muon") == "muon"
        suited = _suited(structure)
        if suited and is_usual:
            if "batch" in settings:
                suited = {key: value for key, value in suited.items() if key not in LARGE_BATCHES}
            settings = suited | settings
        return cls(**settings)

    def check(self) -> None:
        check_widths(self.network, self.widths)

    @property
    def hash(self) -> str:
        """Sixteen hex digits that name this configuration: all but the memory, which matters to few datasets.

        Runs of before windows were weighed go on, too.
        """
        values = self.model_dump(exclude={"memory"} if self.calm else {"memory", "calm"})
        return hashlib.sha256(canonical_json(values).encode()).hexdigest()[:16]

    @property
    def chunks(self) -> int:
        """Compiled calls in the whole run."""
        return -(-self.updates // UPDATES_PER_CHUNK)

    def batch_at(self, unroll: int) -> int:
        """Return how many windows a batch has whose loss spans `unroll` super steps."""
        return max(1, self.batch // unroll)

    def unroll_at(self, chunk: int) -> int:
        """Return how many super steps the loss of chunk number `chunk` spans.

        More than `MAX_UNROLL` after single ones are come to by doubling, in half of the updates that are unrolled.
        """
        first = round(self.chunks * (1 - self.unroll_share))
        if chunk < first:
            return 1
        if self.unroll <= MAX_UNROLL or first == 0:
            return self.unroll
        doublings = math.ceil(math.log2(self.unroll))
        share = (chunk - first) / (self.chunks - first)
        return min(self.unroll, 2 ** (1 + int(2 * share * (doublings - 1))))
