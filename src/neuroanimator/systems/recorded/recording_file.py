"""The file of recordings from which a system is known, and its contents according to the definition."""

from __future__ import annotations

from dataclasses import dataclass

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.state.layout import Layout
from neuroanimator.systems.recorded.recording import Recording
from neuroanimator.systems.recorded.velocities import prepared

STEP_TOLERANCE = 1e-5
"""Relative tolerance of the sampling interval against the one in the TOML file: both are rounded."""


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

    def read(self) -> Recording:
        """Return the recordings in the file.

        Raises BadFileError unless the user has allowed the file (`trust_files`) and it holds the runs of its
        definition, ArgumentError if its columns or its step differ.
        """
        recording = prepared(self.sha256, self.name, self.is_resampled, self.has_estimates)
        _check_columns(recording, "state", self.state, recording.state)
        _check_columns(recording, "control", self.control, recording.control)
        rows = tuple(len(states) for states in recording.states)
        if rows != self.rows:
            raise BadFileError(
                f"{recording.file}: its runs are not those of its definition. Pass its TOML file again."
            )
        if abs(recording.step - self.step) > STEP_TOLERANCE * recording.step:
            raise ArgumentError(
                f"physics.step: {recording.file} is sampled every {recording.step:g} s, got {self.step:g}."
            )
        return recording


def _check_columns(
    recording: Recording, vector: str, layout: Layout, columns: tuple[tuple[str, str], ...]
) -> None:
    defined = [f"{part.name} {part.unit}" for part in layout.slices if part.size == 1]
    recorded = [f"{name} {unit}" for name, unit in columns]
    if defined != recorded or layout.size != len(recorded):
        raise ArgumentError(
            f"{recording.file}: {vector} columns are {', '.join(recorded)}; the TOML file says {', '.join(defined)}."
        )
