"""Recordings of an arm of the family: random parameters, random torques, and noise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.state.columns import column_names
from neuroanimator.systems.random_controls import sample_controls
from neuroanimator.systems.system import System

NOISE = 0.01
"""Standard deviation of the noise in each number, as a share of its own."""

START = (0.3, -0.2, 0.1)
"""Angles at the start [rad]."""


@dataclass(frozen=True)
class Recording:
    """A motion as its sensors show it, and the body it is of."""

    true: Float[np.ndarray, " P"]
    """Its parameters."""
    measured: Float[np.ndarray, "F S"]
    """Angles and velocities at the start and after each super step, without parameters."""
    controls: Float[np.ndarray, "T C"]
    dt: float
    """Time between frames [s]."""


def record(system: System, dt: float, seconds: float, seed: int) -> Recording:
    """Return a motion of a random body of the family."""
    rng = np.random.default_rng(seed)
    start = system.rest.copy()
    true = np.array([rng.uniform(p.low, p.high) for p in system.parameters])
    start[system.parameter_entries] = true
    start[: len(START)] = START
    controls = sample_controls(rng, round(seconds / dt), dt, system.bounds)
    states = system.simulate(start[None], controls[None], dt).states[0]
    shown = states[:, : system.parameter_entries.start]
    noise = NOISE * shown.std(axis=0) * rng.normal(size=shown.shape)
    return Recording(true, shown + noise, controls, dt)


def write_recording(path: Path, recording: Recording, system: System) -> None:
    """Write a recording as a CSV file that `na.identify` reads."""
    frames, moving = recording.measured.shape
    states = [f"state.{name}" for name in column_names(system.state)[:moving]]
    controls = [f"control.{name}" for name in column_names(system.control)]
    times = recording.dt * np.arange(frames)
    held = np.vstack([recording.controls, recording.controls[-1:]])
    table = np.column_stack([times, recording.measured, held])
    header = ",".join(["time s", *states, *controls])
    np.savetxt(path, table, "%.9g", ",", header=header, comments="", encoding="utf-8")
