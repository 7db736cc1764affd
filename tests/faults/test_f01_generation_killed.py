"""Generation killed at any moment and started again ends with the same bytes; so it does with any number of threads."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from processes import GENERATE, killed_at_random, leftovers
from tally import Tally

from neuroanimator import DatasetConfig, generate

SIX_THOUSAND = DatasetConfig(system="pendulum", count=6000)


def check_same(dataset: Path, folder: Path, tally: Tally) -> None:
    paths = sorted(dataset.glob("*.*s*"))
    assert len(paths) == 3
    for path in paths:
        tally.expect(folder / path.name, path.read_bytes())
    assert not leftovers(folder)


def kill_and_resume(dataset: Path, folder: Path, tally: Tally, kills: int, longest: float) -> None:
    arguments = (*GENERATE, folder)
    rng = random.Random(0)
    tally.tried += sum(killed_at_random(rng, longest, *arguments) for _ in range(kills))
    generate(SIX_THOUSAND, folder)
    check_same(dataset, folder, tally)


def test_f01_killed_and_started_again_it_ends_with_the_same_bytes(
    dataset: Path, tmp_path: Path, tally: Tally
):
    kill_and_resume(dataset, tmp_path, tally, kills=5, longest=0.8)
    assert tally.tried


@pytest.mark.endurance
def test_f01_killed_twenty_times_it_ends_with_the_same_bytes(
    dataset: Path, tmp_path: Path, tally: Tally
):
    for number in range(4):
        kill_and_resume(dataset, tmp_path / str(number), tally, kills=5, longest=1.2)


def test_f20_the_bytes_do_not_depend_on_threads(dataset: Path, tmp_path: Path, tally: Tally):
    generate(SIX_THOUSAND, tmp_path, threads=4)
    check_same(dataset, tmp_path, tally)
