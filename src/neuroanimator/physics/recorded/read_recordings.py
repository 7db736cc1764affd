"""The recordings from which a system is known, read and held against its definition."""

from __future__ import annotations

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.physics.recorded.recording import Recording
from neuroanimator.physics.recorded.velocities import prepared
from neuroanimator.state.columns import NamesAndUnits
from neuroanimator.state.layout import Layout
from neuroanimator.systems.recording_file import RecordingFile

STEP_TOLERANCE = 1e-5
"""Relative tolerance of the sampling interval against the one in the TOML file: both are rounded."""


def read_recordings(recordings: RecordingFile) -> Recording:
    """Return the recordings in the file.

    Raises BadFileError unless the user has allowed the file (`trust_files`) and it holds the runs of its
    definition, ArgumentError if its columns or its step differ.
    """
    recording = prepared(
        recordings.sha256, recordings.name, recordings.is_resampled, recordings.has_estimates
    )
    _check_columns(recording, "state", recordings.state, recording.state)
    _check_columns(recording, "control", recordings.control, recording.control)
    rows = tuple(len(states) for states in recording.states)
    if rows != recordings.rows:
        raise BadFileError(
            f"{recording.file}: its runs are not those of its definition. Pass its TOML file again."
        )
    if abs(recording.step - recordings.step) > STEP_TOLERANCE * recording.step:
        raise ArgumentError(
            f"physics.step: {recording.file} is sampled every {recording.step:g} s, got {recordings.step:g}."
        )
    return recording


def _check_columns(
    recording: Recording, vector: str, layout: Layout, columns: NamesAndUnits
) -> None:
    defined = [f"{part.name} {part.unit}" for part in layout.slices if part.size == 1]
    recorded = [f"{name} {unit}" for name, unit in columns]
    if defined != recorded or layout.size != len(recorded):
        raise ArgumentError(
            f"{recording.file}: {vector} columns are {', '.join(recorded)}; the TOML file says {', '.join(defined)}."
        )
