"""What a user waits for most is the compiler: a first controller needs few programs, and none for conversions."""

from __future__ import annotations

import logging

import jax
import numpy as np
import pytest
from swing_up import stand_upright

from neuroanimator import DescentOptions, Emulator, descend
from neuroanimator.emulator.arrays import as_jax

FEW = 5
"""Of a descent: the objective alone, its quadratic model, J of several z, the controls; and one to spare."""


def compiled_names(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [
        record.message
        for record in caplog.records
        if record.message.startswith("Finished XLA compilation")
    ]


def test_a_first_descent_compiles_few_programs(shipped: Emulator, caplog: pytest.LogCaptureFixture):
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        descend(
            shipped, stand_upright(), np.zeros(6), steps=7, options=DescentOptions(iterations=2)
        )
    assert 1 <= len(compiled_names(caplog)) <= FEW, compiled_names(caplog)


def test_loading_an_emulator_compiles_nothing(caplog: pytest.LogCaptureFixture):
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        Emulator.load("truck-25")
    assert not compiled_names(caplog)


def test_numbers_enter_jax_as_they_are_and_as_a_copy():
    numbers = np.array([1.0, 1e300, -2.5])
    found = as_jax(numbers)
    numbers[:] = 0
    np.testing.assert_array_equal(found, np.array([1.0, np.inf, -2.5], np.float32))
    assert as_jax(found) is found or np.array_equal(as_jax(found), found)
