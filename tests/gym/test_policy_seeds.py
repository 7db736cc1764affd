"""Policies trained side by side are those that are trained one by one."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroanimator import load_emulator, load_system
from neuroanimator.errors import ArgumentError
from neuroanimator.executor.local import LocalExecutor
from neuroanimator.gym.policy_seeds import train_policies
from neuroanimator.gym.policy_training import PolicyTraining, train_policy

SMALL = PolicyTraining(widths=(8,), updates=100, batch=4, steps=4, starts=16)


@pytest.mark.endurance
def test_two_seeds_in_two_processes_are_the_policies_of_one(tmp_path: Path):
    with LocalExecutor(2) as executor:
        rows = train_policies("fish", tmp_path, (0, 1), executor, SMALL)
    alone = tmp_path / "alone.policy.safetensors"
    train_policy(load_emulator("fish"), load_system("fish"), alone, SMALL)
    assert rows[0].path.read_bytes() == alone.read_bytes()
    assert rows[1].path.read_bytes() != alone.read_bytes()
    assert [row.best for row in rows].count(True) == 1
    assert min(rows, key=lambda row: row.validation).best


@pytest.mark.parametrize("seeds", [(), (1, 1)])
def test_seeds_that_are_none_or_twice_are_refused(seeds: tuple[int, ...], tmp_path: Path):
    with pytest.raises(ArgumentError, match="seeds: wanted one or more, each once"):
        train_policies("fish", tmp_path, seeds, LocalExecutor(1), SMALL)
