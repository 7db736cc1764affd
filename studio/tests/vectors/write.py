"""Write what Python says of poses and of states between super steps, for the page's tests: run it when either changes.

python studio/tests/vectors/write.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.animation.interpolate import interpolate_hermite
from neuroanimator.animation.motion import random_drive

FOLDER = Path(__file__).parent

SYSTEMS = ("fish", "truck", "pendulum")
"""One whose bones follow mass points, one with a free joint, slides and hinges, one of hinges alone."""

DIGITS = 7
"""Significant digits that are kept of every number."""


def main() -> None:
    """Write one small file per system."""
    for system in SYSTEMS:
        emulator = na.load_emulator(f"{system}-50")
        states = random_drive(emulator, seconds=0.5, seed=3).motion(emulator)[-2:]
        orientations = emulator.state_structure.orientations
        times = np.array([0.0, 0.3, 0.8]) * emulator.dt
        between = interpolate_hermite(states, emulator.dt, times, emulator.rates, orientations)
        assert emulator.skeleton is not None
        positions, quaternions = emulator.skeleton.world_poses(between)
        described = emulator.skeleton.to_json()
        bones = described["bones"] if isinstance(described, dict) else described
        for bone in bones:
            bone["shapes"] = []
        vectors = {
            "dt": emulator.dt,
            "rates": [[int(i), int(j)] for i, j in emulator.rates],
            "orientations": [[int(i), int(j)] for i, j in orientations],
            "skeleton": bones,
            "states": _rounded(states),
            "shares": [0.0, 0.3, 0.8],
            "between": _rounded(between),
            "positions": _rounded(positions.reshape(len(times), -1)),
            "quaternions": _rounded(quaternions.reshape(len(times), -1)),
        }
        text = json.dumps(vectors, separators=(",", ":"))
        (FOLDER / f"{system}.json").write_text(text + "\n")


def _rounded(rows: np.ndarray) -> list[list[float]]:
    return [[float(f"{number:.{DIGITS}g}") for number in row] for row in rows]


if __name__ == "__main__":
    main()
