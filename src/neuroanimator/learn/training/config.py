"""Configuration of a training: every choice on which the weights depend, besides the data."""

from __future__ import annotations

import hashlib
import math
import re
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, field_validator

from neuroanimator.emulator.networks import DEFAULT_WIDTHS, NETWORKS, check_widths
from neuroanimator.errors import ArgumentError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.files.tables import Settings
from neuroanimator.learn.data.config import MAX_UNROLL
from neuroanimator.learn.data.stored import DEFAULT_MEMORY
from neuroanimator.state.structure import Structure
from neuroanimator.systems.system import LONG_WINDOW
from neuroanimator.text import quoted

UPDATES_PER_CHUNK = 250
"""Number of updates in one compiled call: enough to hide the call, few enough for a lively progress bar."""

MAX_UPDATES = 10_000_000
"""Maximum number of updates, above which it is a typing error."""

DRAWS = 3
"""Version of how minibatches follow from the seed: a run that another version began is not continued."""

ON_GROUND: dict[str, Any] = {"widths": (256, 192), "updates": 10_000}
"""Settings for bodies that may touch the ground: with half the units, errors of a walking robot are a fifth larger."""

WITH_STOPS: dict[str, Any] = {"widths": (128, 96), "updates": 20_000}
"""Settings for bodies whose joints have stops, and that touch nothing: narrower layers have time for more updates."""

WITH_MUSCLES: dict[str, Any] = {"widths": (128, 96), "updates": 12_000}
"""Settings for soft bodies with muscles: with the default widths errors are a fifth larger."""

LEAPING: dict[str, Any] = {"widths": (192, 160), "updates": 12_000, "calm": 0.3}
"""Settings for those that may leave the water: falls and splashes change them ten times as much as a stroke does."""

SOFT: dict[str, Any] = {
    "network": "linear-glu",
    "widths": (256, 256),
    "updates": 5_000,
    "unroll": LONG_WINDOW,
    "unroll_share": 0.6,
    "error_growth": 1.0,
}
"""Settings for soft bodies: they are damped, so that errors grow slowly in the end, and final errors count."""

MIN_MEMORY = 16 * 10**6
"""Minimum memory, below which not even one shard of the smallest system fits [bytes]."""

MAX_MEMORY = 10**15
"""Maximum memory, above which it is a typing error [bytes]."""

SIZE_UNITS = {"kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}

SIZE = re.compile(r"([0-9]{1,12}(?:\.[0-9]{1,6})?) ?(kB|MB|GB|TB)", re.ASCII)

DEFAULT_RATES = {"soap": 1e-2, "adam": 5e-3, "momentum": 2e-2}


if TYPE_CHECKING:  # type checkers want the names written out
    NetworkName = str
else:
    NetworkName = Literal[tuple(NETWORKS)]


def _suited(structure: Structure) -> dict[str, Any]:
    """Return the settings for states of this `structure` that differ from the defaults."""
    if structure.shape_contacts is not None:
        return SOFT
    if structure.swimmer is not None:
        return LEAPING if structure.is_immersed else WITH_MUSCLES
    if structure.contacts is None:
        return {}
    return ON_GROUND if structure.contacts.points else WITH_STOPS


class TrainingConfig(Settings):
    """A training run: single super steps first, then a share of updates unrolled over several.

    Raises ArgumentError naming the field at fault.
    """

    network: NetworkName = "gated"
    widths: tuple[int, ...] = Field(default=(), validate_default=True)
    """Number of units in each hidden layer; the network's default if empty."""
    optimizer: Literal["soap", "adam", "momentum"] = "soap"
    learning_rate: float = Field(
        default=0.0, ge=0, lt=10, allow_inf_nan=False, validate_default=True
    )
    """Highest learning rate; the optimiser's default if 0."""
    updates: int = Field(default=8_000, ge=UPDATES_PER_CHUNK, le=MAX_UPDATES)
    batch: int = Field(default=2048, ge=4, le=65_536)
    """Number of super steps in a minibatch: with fewer updates of larger ones errors are as small, and both cores are busy."""
    rare_share: float = Field(default=0.0, ge=0, lt=1)
    """Share of each batch drawn from the tenth of windows with the most unusual changes, such as touchdowns."""
    position_modes: int = Field(default=0, ge=0, le=256)
    """Number of shape modes of a deformable body for positions; with 0, all that matter. See `shape_modes`."""
    velocity_modes: int = Field(default=0, ge=0, le=256)
    local_modes: int = Field(default=4, ge=1, le=64)
    """Number of shape modes of each segment of a hierarchy, besides its rigid motion."""
    unroll: int = Field(default=MAX_UNROLL, ge=1, le=LONG_WINDOW)
    unroll_share: float = Field(default=0.2, ge=0, le=1)
    error_growth: float = Field(default=2.0, ge=0, le=4)
    """Power of the number of super steps with which squared errors are expected to grow: the loss divides them by it."""
    calm: float = Field(default=0.0, ge=0, le=1e3)
    """Mean square change in a super step, over the usual one, above which windows count less the more they change; 0: all
    count alike, so that fast motion, with its large changes and errors, dominates the loss. Windows of soft bodies that move
    freely are weighed by their errors instead."""
    validation_share: float = Field(default=0.05, gt=0, lt=0.9)
    patience: int = Field(default=80, ge=1)
    seed: int = Field(default=0, ge=0, lt=2**31)
    memory: int = Field(default=DEFAULT_MEMORY, ge=MIN_MEMORY, le=MAX_MEMORY)
    """Maximum memory of windows, besides the program itself [bytes], or text such as `1GB`. A larger dataset stays on disk,
    and its windows come in another order; for one that fits, nothing depends on this."""

    @field_validator("memory", mode="before")
    @classmethod
    def _bytes_of(cls, memory: Any) -> Any:
        if not isinstance(memory, str):
            return memory
        match = SIZE.fullmatch(memory)
        if match is None:
            raise ArgumentError(
                f"memory: wanted a size such as 500MB, 8GB or 1.5TB; got {quoted(memory)}."
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
        """Return the default configuration for states of this `structure`, changed by `settings`."""
        is_usual = settings.get("network", "gated") in ("gated", "glu")
        is_usual &= settings.get("optimizer", "soap") == "soap"
        if is_usual:
            settings = _suited(structure) | settings
        return cls(**settings)

    def check(self) -> None:
        check_widths(self.network, self.widths)

    @property
    def hash(self) -> str:
        """Sixteen hex digits that identify this configuration, without the memory, which matters to few datasets."""
        values = self.model_dump(exclude={"memory"}) | {"draws": DRAWS}
        return hashlib.sha256(canonical_json(values).encode()).hexdigest()[:16]

    @property
    def chunks(self) -> int:
        """Number of compiled calls in the whole run."""
        return -(-self.updates // UPDATES_PER_CHUNK)

    @property
    def whole_updates(self) -> int:
        """Number of updates in the whole run: `updates`, rounded up to whole calls."""
        return self.chunks * UPDATES_PER_CHUNK

    def batch_at(self, unroll: int) -> int:
        """Return the number of windows in a batch whose loss spans `unroll` super steps."""
        return max(1, self.batch // unroll)

    def unroll_at(self, chunk: int) -> int:
        """Return the number of super steps in the loss of chunk number `chunk`.

        Above `MAX_UNROLL` it is reached by doubling from single ones, in half of the unrolled updates.
        """
        first = round(self.chunks * (1 - self.unroll_share))
        if chunk < first:
            return 1
        if self.unroll <= MAX_UNROLL or first == 0:
            return self.unroll
        doublings = math.ceil(math.log2(self.unroll))
        share = (chunk - first) / (self.chunks - first)
        return min(self.unroll, 2 ** (1 + int(2 * share * (doublings - 1))))
