"""A first definition for somebody's recordings: what their columns say, and what their numbers show."""

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
"""[rad] An angle that covers more than this is seen by sine and cosine."""

RATE_ERROR = 0.15
"""Rms difference between a slope and a rate, over the rate's own, up to which one is taken for the other."""


def propose_recording(path: Path) -> tuple[RecordedDefinition, dict[str, str]]:
    """Return a definition of the recordings at `path`, which the user allowed, and notes on its keys."""
    digest = digest_of(path)
    recording = read_recording(digest, path.name)
    rates = _rates(recording)
    values = {
        "name": path.stem.lower().replace(" ", "-"),
        "kind": "recorded",
        "file": path.name,
        "substeps": proposed_substeps(recording.step),
        "physics": {"step": recording.step},
        "state": [
            _state_part(recording, entry, rates.get(entry)) for entry in range(len(recording.state))
        ],
        "control": [
            _control_part(recording, entry, path) for entry in range(len(recording.control))
        ],
    }
    notes = {"physics.step": f"the sampling interval [s]; {len(recording.states)} runs"}
    return check_table(values, path.name, RecordedDefinition), notes


def _state_part(recording: Recording, entry: int, rate: int | None) -> dict[str, Any]:
    name, unit = recording.state[entry]
    column = np.concatenate([states[:, entry] for states in recording.states])
    is_full_turn = unit == "rad" and np.ptp(column) > HALF_TURN
    return {
        "name": name,
        "unit": unit,
        "feature": "sine" if is_full_turn else "plain",
        "rate": "" if rate is None else recording.state[rate][0],
        "rest": [float(f"{recording.states[0][0, entry]:.6g}")],
    }


def _control_part(recording: Recording, entry: int, path: Path) -> dict[str, Any]:
    name, unit = recording.control[entry]
    column = np.concatenate([controls[:, entry] for controls in recording.controls])
    if np.ptp(column) == 0:
        raise BadFileError(
            f"{path.name}: control.{name} never changes, so nothing can be learned of it. Remove the column."
        )
    return {"name": name, "unit": unit, "low": [float(column.min())], "high": [float(column.max())]}


def _rates(recording: Recording) -> dict[int, int]:
    """Return {entry: the entry that is its rate of change}, where units and numbers agree."""
    found = {}
    for entry, (_, unit) in enumerate(recording.state):
        for other, (_, rate) in enumerate(recording.state):
            if rate == rate_unit(unit) and _is_rate(recording, entry, other):
                found[entry] = other
    return found


def _is_rate(recording: Recording, entry: int, other: int) -> bool:
    """Return whether the slope of one entry is the other, as far as differences between samples can tell."""
    slopes = (
        np.concatenate([np.diff(states[:, entry]) for states in recording.states]) / recording.step
    )
    rates = np.concatenate(
        [(states[1:, other] + states[:-1, other]) / 2 for states in recording.states]
    )
    near = (
        np.abs(slopes) < HALF_TURN / recording.step
    )  # an angle that jumps from π to -π has no slope there
    size = np.sqrt(np.mean(rates[near] ** 2)) if near.any() else 0.0
    return bool(size > 0 and np.sqrt(np.mean((slopes - rates)[near] ** 2)) < RATE_ERROR * size)
