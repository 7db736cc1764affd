"""Faults and attacks counted over all tests: tried, survived, and bytes lost."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass
class Tally:
    """What one test tried. A test that says nothing tried one thing."""

    counts: list[int] = field(default_factory=lambda: [0, 0])
    """Tried, and bytes lost: a list, for the test's report is written before its fixtures end."""

    @property
    def tried(self) -> int:
        return self.counts[0]

    @tried.setter
    def tried(self, count: int) -> None:
        self.counts[0] = count

    def expect(self, path: Path, content: bytes) -> None:
        """Check that the file is what it should be, and count its bytes as lost if not."""
        found = path.read_bytes() if path.exists() else b""
        if found != content:
            self.counts[1] += len(content)
        assert found == content, f"{path} is not what it was"


def tally_line(stats: dict[str, list[Any]]) -> str:
    """Return one line for the reports of a test session; empty where nothing was tried."""
    faults, attacks = _counted(stats, "fault"), _counted(stats, "attack")
    parts = []
    if faults[0]:
        parts.append(
            f"faults tried {faults[0]:,}, survived {faults[1]:,}, bytes lost {faults[2]:,}"
        )
    if attacks[0]:
        parts.append(f"attacks tried {attacks[0]:,}, refused {attacks[1]:,}")
    return "; ".join(parts)


def _counted(stats: dict[str, list[Any]], mark: str) -> tuple[int, int, int]:
    """Return (tried, survived, bytes lost) of the tests marked `mark`."""
    tried = survived = lost = 0
    for outcome in ("passed", "failed"):
        for report in stats.get(outcome, []):
            if (report.when != "call" and outcome == "passed") or mark not in report.keywords:
                continue
            counts = [value for name, value in report.user_properties if name == "tally"]
            said, gone = counts[0] if counts else (0, 0)
            tried += max(1, said)
            survived += max(1, said) if outcome == "passed" else 0
            lost += gone
    return tried, survived, lost
