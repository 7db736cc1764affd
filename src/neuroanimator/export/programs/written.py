"""What an export leaves behind."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


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
    """On so many inputs."""
    difference: float
    """The largest one, in units of the output."""

    def summary(self) -> str:
        """Return one line: what was written, its size, and how it was checked."""
        others = ", ".join(path.name for path in self.others)
        return (
            f"{self.path}: {self.size / 1e3:.0f} kB; in {self.runtime} {self.checked:,} inputs give what they give in "
            f"JAX, to {self.difference:.0e} of the output's scale. Beside it: {others}."
        )
