"""A fleet is the same bytes from any executor, goes on where it stopped, and is refused whole if anything is wrong."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from neuroanimator import load_emulator
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.learn.evaluation.fleets.fleet_file import is_fleet, read_fleet
from neuroanimator.learn.evaluation.fleets.train_fleet import ROWS, TABLE, FleetRow, train_fleet

SMALL = """
systems = ["pendulum"]
seeds = [0, 1]
count = 1200
samples_per_run = 12
seconds = 0.1
[sizes.tiny]
widths = [4]
updates = 250
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "fleet.toml"
    path.write_text(text)
    return path


def trained(folder: Path, out: Path, workers: int = 1) -> tuple[list[FleetRow], int]:
    """Return (rows, how many were trained)."""
    began: list[int] = []
    with LocalExecutor(workers) as executor:
        fleet = read_fleet(written(folder, SMALL))
        rows = train_fleet(fleet, out, executor, on_start=began.append)
    return rows, began[0]


def table_of(out: Path) -> list[dict[str, str]]:
    lines = (out / TABLE).read_text().splitlines()
    return list(csv.DictReader(lines[1:]))


@pytest.mark.endurance  # tests/faults and tests/executor show the same of other tasks
def test_a_fleet_is_the_same_bytes_by_one_process_and_by_two_and_makes_nothing_twice(
    tmp_path: Path,
):
    rows, count = trained(tmp_path, tmp_path / "one")
    assert count == 2
    assert [row.name for row in rows] == ["pendulum-50-tiny-0", "pendulum-50-tiny-1"]
    assert [row.best for row in rows].count(True) == 1
    assert min(rows, key=lambda row: row.error).best
    assert trained(tmp_path, tmp_path / "one") == (rows, 0)
    # As after a kill: one emulator is damaged, and its row is there.
    spread = tmp_path / "two"
    assert trained(tmp_path, spread, workers=2) == (rows, 2)
    path = spread / "pendulum-50-tiny-1.emulator.safetensors"
    content = path.read_bytes()
    path.write_bytes(content[:-1])
    assert trained(tmp_path, spread) == (rows, 1)
    assert path.read_bytes() == content
    assert load_emulator(str(path)).substeps == 50
    assert [row["name"] for row in table_of(spread)] == [row.name for row in rows]
    names = {path.name for path in (tmp_path / "one").glob("*.safetensors")}
    assert names == {f"{row.name}.emulator.safetensors" for row in rows}
    # Another fleet's folder is left alone.
    other = written(tmp_path, SMALL.replace("updates = 250", "updates = 500"))
    with LocalExecutor(1) as executor, pytest.raises(NeuroAnimatorError, match="another fleet's"):
        train_fleet(read_fleet(other), spread, executor)
    assert len(list((spread / ROWS).iterdir())) == 2


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (
            '"pendulum"',
            '"pendulum", "pendulm"',
            "fleet.toml: 'pendulm': No system called 'pendulm'",
        ),
        (
            '"pendulum"',
            '"pendulum", "pendulum"',
            "more than one emulator would be called pendulum-50",
        ),
        ("seeds = [0, 1]", "seeds = [0, 0]", "would be called pendulum-50-tiny-0"),
        ('"pendulum"', '"mine.toml"', "fleet.toml: 'mine.toml': Could not read .*mine.toml"),
        ("widths = [4]", "width = [4]", "'pendulum': width: extra inputs"),
        ("seeds = [0, 1]", "sedes = [0, 1]", "fleet.toml: sedes: extra inputs"),
        ("seeds = [0, 1]", "substeps = [7]", "not a whole number|whole number of"),
        ("seeds = [0, 1]", "seeds = []", "fleet.toml: seeds"),
        ("[sizes.tiny]", '[sizes."../tiny"]', "fleet.toml: sizes"),
    ],
)
def test_a_fleet_with_a_fault_is_refused_before_anything_starts(
    old: str, new: str, match: str, tmp_path: Path
):
    with pytest.raises(NeuroAnimatorError, match=match) as raised:
        read_fleet(written(tmp_path, SMALL.replace(old, new)))
    assert "\n" not in str(raised.value)


def test_a_systems_file_is_no_fleet(tmp_path: Path):
    assert is_fleet(written(tmp_path, SMALL))
    assert not is_fleet(written(tmp_path, 'kind = "mujoco"\n'))
    assert not is_fleet(tmp_path)
    assert not is_fleet(tmp_path / "nothing.toml")


def test_the_command_line_prints_the_table_and_refuses_settings_of_one_emulator(
    tmp_path: Path, cli
):
    written(tmp_path, SMALL.replace("seeds = [0, 1]", "seeds = [0]"))
    refused = cli("train", "fleet.toml", "--out", "fleet", "--updates", 250, cwd=tmp_path)
    assert refused.returncode == 2
    assert "is a fleet: set updates in its sizes" in refused.stderr
    assert not (tmp_path / "fleet").exists()
    made = cli("train", "fleet.toml", "--out", "fleet", cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    assert "pendulum-50-tiny-0" in made.stdout
