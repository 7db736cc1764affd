"""Tables of measurements: what is measured anew takes the place of what was."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.harness import merge_csv, read_rows
from neuroanimator.learn.evaluation import csv_table
from neuroanimator.learn.evaluation.csv_table import write_csv

ROWS = [
    {"body": "a", "seed": 0, "error": 0.123456789},
    {"body": "a", "seed": 1, "error": 0.2},
    {"body": "b", "seed": 0, "error": 0.3},
]


def test_a_table_is_read_as_it_was_written(tmp_path: Path):
    path = tmp_path / "table.csv"
    assert read_rows(path) == []
    write_csv(path, [*ROWS, {"body": "c", "seed": 0, "time": 1.5}])
    rows = read_rows(path)
    assert rows[0] == {"body": "a", "seed": "0", "error": "0.12346", "time": ""}
    written = path.read_bytes()
    write_csv(path, rows)
    assert path.read_bytes() == written


def test_rows_measured_anew_take_the_place_of_older_ones(tmp_path: Path):
    path = tmp_path / "table.csv"
    write_csv(path, ROWS)
    new = {"body": "a", "seed": 1, "error": 0.4}
    merge_csv(path, [new], "body", "seed")
    assert [row["error"] for row in read_rows(path)] == ["0.12346", "0.3", "0.4"]
    whole = merge_csv(path, [new], "body", order=lambda row: row["body"])
    assert [row["body"] for row in whole] == ["a", "b"]


def test_the_first_line_names_every_machine_that_rows_come_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "table.csv"
    machines = []
    for name, rows in [("A", ROWS), ("B", ROWS[:1]), ("A", ROWS[:1]), ("C", ROWS)]:
        monkeypatch.setattr(csv_table, "describe_machine", lambda name=name: name)
        merge_csv(path, rows, "body", "seed")
        machines.append(path.read_text().splitlines()[0])
    assert machines == ["# A", "# A; B", "# A; B", "# C"]
