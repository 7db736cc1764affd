"""Settings of an improvement: every choice its result depends on, besides the emulator and its data."""

from __future__ import annotations

from pydantic import Field

from neuroanimator.files.tables import Settings
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK

RUN_LENGTH = 15
"""Number of super steps in a simulated run: twelve windows begin in each."""


class ImprovementConfig(Settings):
    """Settings of the rounds of searching, simulating and training on.

    Raises ArgumentError naming the field that is wrong.
    """

    samples: int = Field(default=6_000, ge=60 * RUN_LENGTH, le=10_000_000)
    """Number of new super steps simulated in a round, including those of the probe."""
    rounds: int = Field(default=6, ge=1, le=100)
    updates: int = Field(default=4_000, ge=UPDATES_PER_CHUNK, le=10_000_000)
    """Number of weight updates of a round."""
    windows: int = Field(default=100_000, ge=4_000, le=10_000_000)
    """Number of windows learnt from in a round, nine of ten of them old: trained on few, an emulator forgets the rest."""
    seed: int = Field(default=0, ge=0, lt=2**31)

    @property
    def runs(self) -> int:
        """Number of runs simulated in a round."""
        return self.samples // RUN_LENGTH
