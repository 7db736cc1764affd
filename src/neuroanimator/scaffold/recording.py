"""Propose a definition for recordings: what their columns say, and what their numbers show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.scaffold.defaults import proposed_substeps
from neuroanimator.state.units import rate_unit
from neuroanimator.systems.recorded.recording import Recording, read_recording
from neuroanimator.systems.trusted_files import digest_of
from neuroanimator.tables import check_table

HALF_TURN = np.pi
"""An angle that covers more than this [rad] is represented by its sine and cosine."""

RATE_ERROR = 0.15
"""A column is taken for a slope if their rms difference is less than this share of the column's own rms."""


def propose_recording(path: Path) -> tuple[RecordedDefinition, dict[str, str], tuple[str, ...]]:
    """Return a definition of the recordings at `path` and notes on its keys.

    The user must have allowed the file to be opened, see `trust_file`. Raises BadFileError for a
    control that never changes.
    """
    digest = digest_of(path)
    recording = read_recording(digest, path.name)
    rates = _rates(recording)
    state = []
    for entry in range(len(recording.state)):
        state.append(_state_part(recording, entry, rates.get(entry)))
    control = []
    for entry in range(len(recording.control)):
        control.append(_control_part(recording, entry, path))
    values = {
        "name": path.stem.lower().replace(" ", "-"),
        "kind": "recorded",
        "file": path.name,
        "substeps": proposed_substeps(recording.step),
        "physics": {"step": recording.step},
        "state": state,
        "control": control,
    }
    notes = {"physics.step": f"the sampling interval [s]; {len(recording.states)} runs"}
    return check_table(values, path.name, RecordedDefinition), notes, ()


def _state_part(recording: Recording, entry: int, rate_entry: int | None) -> dict[str, Any]:
    """Return the TOML table of one state column, whose rate of change is the column `rate_entry`."""
    name, unit = recording.state[entry]
    column = np.concatenate([states[:, entry] for states in recording.states])
    is_full_turn = unit == "rad" and np.ptp(column) > HALF_TURN
    feature = "plain"
    if is_full_turn:
        feature = "sine"
    rate = ""
    if rate_entry is not None:
        rate, _ = recording.state[rate_entry]
    first = recording.states[0][0, entry]
    return {
        "name": name,
        "unit": unit,
        "feature": feature,
        "rate": rate,
        "rest": [float(f"{first:.6g}")],
    }


def _control_part(recording: Recording, entry: int, path: Path) -> dict[str, Any]:
    """Return the TOML table of one control column."""
    name, unit = recording.control[entry]
    column = np.concatenate([controls[:, entry] for controls in recording.controls])
    if np.ptp(column) == 0:
        raise BadFileError(
            f"{path.name}: control.{name} never changes, so nothing can be learned of it. Remove the column."
        )
    low = float(column.min())
    high = float(column.max())
    return {"name": name, "unit": unit, "low": [low], "high": [high]}


def _rates(recording: Recording) -> dict[int, int]:
    """Return {entry: the entry that is its rate of change}, where units and numbers agree."""
    rates = {}
    for entry, (_, unit) in enumerate(recording.state):
        for other, (_, other_unit) in enumerate(recording.state):
            if other_unit == rate_unit(unit) and _is_rate(recording, entry, other):
                rates[entry] = other
    return rates


def _is_rate(recording: Recording, entry: int, other: int) -> bool:
    """Return whether the slope of one entry is the other, as far as differences between samples can tell."""
    differences = [np.diff(states[:, entry]) for states in recording.states]
    slopes = np.concatenate(differences) / recording.step
    midpoints = [(states[1:, other] + states[:-1, other]) / 2 for states in recording.states]
    rates = np.concatenate(midpoints)
    # An angle that jumps from pi to -pi has no slope there.
    is_smooth = np.abs(slopes) < HALF_TURN / recording.step
    if not is_smooth.any():
        return False
    rms_rate = np.sqrt(np.mean(rates[is_smooth] ** 2))
    rms_difference = np.sqrt(np.mean((slopes - rates)[is_smooth] ** 2))
    return bool(rms_rate > 0 and rms_difference < RATE_ERROR * rms_rate)
