"""What only a long run shows: memory that grows, and numbers that part ways between C and JAX."""

from __future__ import annotations

import resource

import jax
import numpy as np
import pytest
from tally import Tally

from neuroanimator import load_emulator
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.emulator.c_emulator import c_emulator
from neuroanimator.emulator.super_step import step
from neuroanimator.files.zoo import SHIPPED

BLOCK = 1000
"""Super steps of one rollout: few, as the allocator keeps several of its arrays back, now more of them and now fewer."""

MAX_GROWTH = 0.05
CLOSE = 1e-5
"""Of the largest number in a state: both are float32."""


def resident() -> float:
    """Return the memory this process holds now [bytes]."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


@pytest.mark.endurance
@pytest.mark.parametrize("name", ["pendulum-50", "fish-50"])
def test_f18_a_million_steps_take_no_more_memory_than_ten_thousand(name: str):
    emulator = load_emulator(name)
    spec = emulator.spec
    rng = np.random.default_rng(0)
    state = np.asarray(spec.rest, np.float32)

    def advance(state: np.ndarray) -> np.ndarray:
        share = rng.uniform(-1, 1, (BLOCK, spec.control.size)).astype(np.float32)
        return np.asarray(emulator.rollout(state, spec.bounds.middle + share * spec.bounds.half))[
            -1
        ]

    for _ in range(10_000 // BLOCK):
        state = advance(state)
    before = resident()
    for _ in range(1_000_000 // BLOCK):
        state = advance(state)
    assert np.isfinite(state).all()
    assert resident() < (1 + MAX_GROWTH) * before


@pytest.mark.endurance
@pytest.mark.skipif(find_compiler() is None, reason="no C compiler: there is no C to compare")
@pytest.mark.parametrize("name", [f"{system}-{substeps}" for system, substeps in sorted(SHIPPED)])
def test_f19_c_and_jax_say_the_same_of_a_thousand_inputs(name: str, tally: Tally):
    emulator = load_emulator(name)
    program, spec = c_emulator(emulator), emulator.spec
    assert program is not None
    rng = np.random.default_rng(0)
    held = spec.bounds.middle + rng.uniform(-1, 1, (1000, spec.control.size)) * spec.bounds.half
    states = np.asarray(emulator.rollout(spec.rest, held), np.float32)[:-1]
    controls = held.astype(np.float32)
    expected = np.asarray(jax.jit(jax.vmap(step, (None, 0, 0)))(emulator, states, controls))
    found = np.stack([program.step(*each)[0] for each in zip(states, controls, strict=True)])
    tally.tried = len(found)
    assert np.abs(found - expected).max() <= CLOSE * np.abs(expected).max()
