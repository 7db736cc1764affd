"""Every parser for a second under random input, and all inputs that once took a new way.

Guided by coverage, and for as long as there is patience: `make fuzz`.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

from fuzz.corpus import ARCHIVE, PARSERS, read_corpus
from fuzz.mutate import changed_json
from fuzz.one import by_chance
from fuzz.seeds import seeds
from fuzz.targets import TARGETS, try_parser

SECONDS = 5
"""Time all parsers together are under random input [s]."""

MAX_CORPUS = 100_000
"""Maximum size of the archive [bytes]."""


@pytest.mark.parametrize("parser", TARGETS)
def test_every_input_of_the_corpus_is_read_or_refused_in_one_line(parser: str):
    answers = {name: try_parser(parser, content) for name, content in read_corpus(parser).items()}
    assert answers


@pytest.mark.parametrize("parser", TARGETS)
def test_a_parser_takes_random_input(parser: str, tmp_path: Path):
    by_chance(parser, SECONDS / len(TARGETS), tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.endurance
def test_make_fuzz_takes_a_parser_by_name(tmp_path: Path):
    result = subprocess.run(
        [
            sys.executable,
            "-m",
            "fuzz",
            "--seconds",
            "1",
            "--parser",
            "numbers",
            "--crashes",
            tmp_path,
        ],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        errors="replace",
        timeout=PATIENCE,
    )
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-1000:]
    assert "inputs" in result.stdout


def test_the_fuzzer_finds_a_planted_fault_and_keeps_its_input(tmp_path: Path):
    planted = (
        "import sys; from pathlib import Path; import fuzz.targets, fuzz.one\n"
        "def numbers(content):\n"
        "    if len(content) > 8: raise KeyError('planted')\n"
        "fuzz.targets.TARGETS['numbers'] = numbers\n"
        "fuzz.one.main()"
    )
    folder, crashes = tmp_path / "folder", tmp_path / "crashes"
    folder.mkdir()
    crashes.mkdir()
    command = [sys.executable, "-c", planted, "numbers", "60", str(crashes), str(folder)]
    result = subprocess.run(
        command, cwd=Path(__file__).parents[1], capture_output=True, text=True, errors="replace", timeout=PATIENCE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(["." , *sys.path])},
    )  # fmt: skip
    assert result.returncode != 0
    assert "planted" in result.stdout + result.stderr
    (kept,) = crashes.iterdir()
    assert kept.name.startswith("numbers-")
    assert len(kept.read_bytes()) > 8


def test_the_seeds_are_files_users_have():
    # A model without a joint, one that is no MJCF, the lander's definition with another model: near enough.
    refused = {"definition": 1, "model": 1, "toml": 1}
    for parser, files in seeds().items():
        answers = [try_parser(parser, content) for content in files.values()]
        assert sum(map(bool, answers)) <= refused.get(parser, 0), (parser, answers)
        kept = read_corpus(parser)
        for name, content in files.items():
            assert kept[f"seed-{name}"] == content or parser == "npz"


def test_the_corpus_is_small():
    assert sorted(TARGETS) == PARSERS
    assert ARCHIVE.stat().st_size < MAX_CORPUS


def test_json_is_changed_into_json():
    content, rng = json.dumps({"a": [1, {"b": 2}], "c": "d"}).encode(), random.Random(1)
    found = {changed_json(content, rng.getrandbits(32)) for _ in range(200)}
    assert len(found) > 50
    for changed in found:
        assert changed is not None
        json.loads(changed)
    assert changed_json(b"{", 1) is None
