"""What an export leaves behind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from neuroanimator.control.policies.policy import Policy
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.trust_summary import NO_METER


@dataclass(frozen=True)
class Written:
    """What an export wrote, and how it was checked."""

    path: Path
    others: tuple[Path, ...]
    """What lies beside it: test vectors, and what calls a module."""
    size: int
    """Of the program [bytes]."""
    runtime: str
    """What ran the program beside JAX."""
    checked: int
    """Number of inputs it was checked on."""
    difference: float
    """The largest one, in units of the outputs."""
    left_out: str = ""
    """What an older model lacks, and how it gets it."""

    def summary(self) -> str:
        """Return one line: what was written, its size, and how it was checked."""
        others = ", ".join(path.name for path in self.others)
        told = (
            f"{self.path}: {self.size / 1e3:.0f} kB; in {self.runtime} {self.checked:,} inputs give what they give in "
            f"JAX, to {self.difference:.0e} of the output's scale. Beside it: {others}."
        )
        return f"{told} {self.left_out}" if self.left_out else told


def what_is_left_out(model: Emulator | Policy) -> str:
    """Return what is to be said of programs with a score where `model` is an emulator without a meter; else nothing."""
    if isinstance(model, Emulator) and model.meter is None:
        return f"It gives no trust: {NO_METER}."
    return ""
