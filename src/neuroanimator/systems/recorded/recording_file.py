"""The file of recordings a system is known from, and what its definition says is in there."""

from __future__ import annotations

from dataclasses import dataclass

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.state.layout import Layout
from neuroanimator.systems.recorded.recording import Recording, read_recording

STEP_TOLERANCE = 1e-6
"""The sampling interval may differ by this share from the one the TOML file says: both are rounded."""


@dataclass(frozen=True)
class RecordingFile:
    """Recordings by the name and the bytes of their file, and what they must hold."""

    name: str
    """The file's name."""
    sha256: str
    """The digest of the file's bytes, by which it is found among those the user allowed."""
    rows: tuple[int, ...]
    """The number of samples in each run."""
    origins: tuple[str, ...]
    """Where in the file each run begins."""
    state: Layout
    control: Layout
    step: float
    """The sampling interval [s]."""
    angles: tuple[int, ...]
    """The state entries that are angles: they jump by 2π where a recording wraps them."""

    def read(self) -> Recording:
        """Return the recordings as they are in the file.

        Raises BadFileError unless the user allowed the file (`trust_files`) and it holds the runs
        its definition says, ArgumentError if its columns or its step are others.
        """
        recording = read_recording(self.sha256, self.name)
        _check_columns(recording, "state", self.state, recording.state)
        _check_columns(recording, "control", self.control, recording.control)
        rows = tuple(len(states) for states in recording.states)
        if rows != self.rows:
            raise BadFileError(
                f"{recording.file}: other runs than its definition says. Pass its TOML file again."
            )
        if abs(recording.step - self.step) > STEP_TOLERANCE * recording.step:
            raise ArgumentError(
                f"physics.step: {recording.file} is sampled every {recording.step:g} s, came {self.step:g}."
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
