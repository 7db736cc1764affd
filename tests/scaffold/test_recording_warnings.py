"""Before anything is trained, `new` says what recordings lack: velocities, length, motion like the test's, right cells."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import load_system
from neuroanimator.physics.loading import resolve
from neuroanimator.physics.recorded.read_recordings import read_recordings
from neuroanimator.physics.recorded.recorded_system import RecordedSystem
from neuroanimator.scaffold.write_toml import write_definition

NAMES = ("angle rad", "velocity rad/s", "torque N·m")
FORM = ("state.", "state.", "control.")


@cache
def _swing(rows: int = 3000, seed: int = 0) -> np.ndarray:
    """Return angle, velocity and torque of a driven oscillator at 50 Hz."""
    rng = np.random.default_rng(seed)
    torque = np.repeat(rng.uniform(-2, 2, rows // 10), 10)
    angle = 0.5
    velocity = 0.0
    table = []
    for force in torque:
        table.append((angle, velocity, force))
        for _ in range(20):
            velocity += 0.001 * (6 * force - 16 * angle - velocity)
            angle += 0.001 * velocity
    return np.array(table)


def swing(rows: int = 3000) -> np.ndarray:
    return _swing(rows).copy()


def write(folder: Path, table: np.ndarray, columns: tuple[int, ...] = (0, 1, 2)) -> str:
    header = ["time s", *(f"{FORM[column]}{NAMES[column]}" for column in columns)]
    lines = [",".join(header)]
    for k, row in enumerate(table[:, list(columns)]):
        lines.append(",".join([f"{k * 0.02:.2f}", *(f"{value:.7f}" for value in row)]))
    path = folder / "runs.csv"
    path.write_text("\n".join(lines))
    return str(path)


def warnings(path: str) -> str:
    _, proposal = write_definition(path, force=True)
    return "\n".join(proposal.warnings)


def test_nothing_is_said_of_good_recordings(tmp_path: Path):
    assert warnings(write(tmp_path, swing())) == ""


def test_positions_alone_are_told_and_their_velocities_estimated(tmp_path: Path):
    table = swing()
    path = write(tmp_path, table, (0, 2))
    told = warnings(path)
    assert "state.angle: no column holds a velocity" in told
    assert "where a limb is going" in told
    assert "--velocities" in told
    toml, proposal = write_definition(path, force=True, velocities=True)
    assert proposal.warnings == ()
    assert "velocities = true" in toml.read_text()
    system = load_system(*resolve(str(toml))[:2])
    assert isinstance(system, RecordedSystem)
    assert system.recordings is not None
    assert system.structure.rates == ((0, 1),)
    (states,) = read_recordings(system.recordings).states
    np.testing.assert_array_equal(states[:, 0], np.round(table[:, 0], 7))
    error = np.sqrt(np.mean((states[:, 1] - table[:, 1]) ** 2))
    assert error < 0.05 * table[:, 1].std()


@pytest.mark.parametrize(("rows", "is_told"), [(600, True), (3000, False)])
def test_too_few_super_steps_are_told(tmp_path: Path, rows: int, is_told: bool):
    assert (
        "to learn 3 numbers from, wanted about 300" in warnings(write(tmp_path, swing(rows)))
    ) == is_told


def test_a_test_that_goes_further_than_what_is_learnt_is_told(tmp_path: Path):
    table = swing()
    table[-140:, :2] *= 3
    assert "the pieces kept for the test go further" in warnings(write(tmp_path, table))


@pytest.mark.parametrize(
    ("column", "factor"), [(0, -2.0), (0, 10.0), (1, -2.0), (1, 1000.0), (2, 1000.0)]
)
def test_a_single_cell_that_is_off_by_a_factor_is_named_by_line(
    tmp_path: Path, column: int, factor: float
):
    rng = np.random.default_rng(0)
    for _ in range(3):
        table = swing()
        sizes = np.abs(table[:, column])
        sizes[:20] = 0
        row = int(rng.choice(np.flatnonzero(sizes > sizes.max() / 2)))
        table[row, column] *= factor
        told = warnings(write(tmp_path, table))
        name = f"{FORM[column]}{NAMES[column].split(' ')[0]}"
        assert f"{name}: 1 of 3000 samples" in told
        assert f"in line {row + 2}." in told
