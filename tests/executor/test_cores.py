"""Rows spread over cores: each part once, in order, and the same numbers for any number of threads."""

from __future__ import annotations

import numpy as np
import pytest

from neuroanimator import Emulator, set_backend
from neuroanimator.codegen.cores import CORES, in_parts
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.c_emulator import c_emulator
from neuroanimator.gym.batched_step import step_rows

COUNT = 1003
"""Neither a multiple of sixteen nor of the number of threads."""


@pytest.fixture
def in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [])
    set_backend("c")


@pytest.mark.parametrize("cores", ["1", "2", "3", "7"])
@pytest.mark.parametrize("count", [0, 1, 15, 64, COUNT])
def test_parts_are_all_rows_once_and_in_order(
    cores: str, count: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv(CORES, cores)
    parts = in_parts(lambda rows: list(range(rows.start, rows.stop)), count, smallest=16)
    assert [row for part in parts for row in part] == list(range(count))
    assert 1 <= len(parts) <= int(cores)


def test_the_number_of_threads_changes_no_bit(
    shipped: Emulator, in_c: None, monkeypatch: pytest.MonkeyPatch
):
    program = c_emulator(shipped)
    assert program is not None
    rng = np.random.default_rng(0)
    starts = as_float32(rng.normal(size=(COUNT, shipped.state.size)))
    controls = as_float32(rng.normal(size=(COUNT, 8, shipped.control.size)))
    latent = as_float32(shipped.encode(starts))
    found = []
    for cores in ("1", "2", "5"):
        monkeypatch.setenv(CORES, cores)
        motions, are_sound = program.rollouts(starts, controls)
        assert are_sound
        steps = step_rows(shipped, latent, controls[:, 0])
        found.append([motions.tobytes(), *(array.tobytes() for array in steps)])
    assert found[0] == found[1] == found[2]


def test_what_goes_wrong_in_a_thread_is_raised(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(CORES, "2")

    def refuse(rows: slice) -> None:
        if rows.start:
            raise ValueError("the second part")

    with pytest.raises(ValueError, match="the second part"):
        in_parts(refuse, 64, smallest=16)
