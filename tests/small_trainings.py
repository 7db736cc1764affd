"""Options of trainings on the command line that end within seconds."""

from __future__ import annotations


def small_training(updates: int, widths: str, batch: int) -> tuple[str, ...]:
    """Return the options of a training of `updates` of a network of `widths`, such as `16,16`."""
    return ("--updates", str(updates), "--widths", widths, "--batch", str(batch))
