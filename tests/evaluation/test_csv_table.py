"""Tables of measurements: what is measured anew takes the place of what was."""

from __future__ import annotations

from pathlib import Path

from neuroanimator.evaluation.csv_table import other_rows, read_rows, write_csv

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
    assert [row["body"] for row in other_rows(path, ROWS[:1], "body")] == ["b"]
    left = other_rows(path, ROWS[:1], "body", "seed")
    assert [(row["body"], row["seed"]) for row in left] == [("a", "1"), ("b", "0")]
    assert other_rows(path, ROWS, "body", "seed") == []
