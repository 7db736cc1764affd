"""Where figures are kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from neuroanimator.bench import write_csv

RESULTS = Path(__file__).parent / "results"


def write_results(name: str, rows: list[dict[str, Any]]) -> Path:
    """Write rows to results/`name`, the machine's description in the first line."""
    write_csv(RESULTS / name, rows)
    return RESULTS / name
