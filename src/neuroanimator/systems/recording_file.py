"""The file of recordings from which a system is known, and its contents according to the definition."""

from __future__ import annotations

from dataclasses import dataclass

from neuroanimator.state.layout import Layout


@dataclass(frozen=True)
class RecordingFile:
    """Recordings by the name and the hash of their file, and their expected contents."""

    name: str
    """Name of the file."""
    sha256: str
    """Hash of the file's bytes, by which it is found among those the user has allowed."""
    rows: tuple[int, ...]
    """Number of samples in each run."""
    origins: tuple[str, ...]
    """Start of each run in the file, in words."""
    state: Layout
    control: Layout
    step: float
    """Sampling interval [s]."""
    is_resampled: bool
    """Whether samples at uneven times are interpolated."""
    has_estimates: bool
    """Whether velocities that the file does not hold are estimated."""
    angles: tuple[int, ...]
    """State entries that are angles: they jump by 2π where a recording wraps them."""
