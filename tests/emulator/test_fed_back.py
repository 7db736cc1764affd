"""Every state that a call returns is accepted by the next one."""

from __future__ import annotations

import numpy as np
import pytest

from neuroanimator import Emulator, load_emulator, set_backend
from neuroanimator.emulator.checks import MAX_MAGNITUDE
from neuroanimator.errors import ArgumentError, DivergedError

STEPS = 30


@pytest.fixture(params=["c", "jax"])
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [])
    set_backend(request.param)
    return request.param


def starts_near_the_end(emulator: Emulator, count: int) -> np.ndarray:
    """Return states whose places or angles are at, or a little within, the largest that is accepted, and which move."""
    rng = np.random.default_rng(0)
    starts = np.repeat(emulator.rest[None], count, axis=0)
    movable = [0, 1] if emulator.frame.segments else [0, 1, 2]
    rates = dict(emulator.rates)
    first_velocity = next(i for i, name in enumerate(emulator.state.names) if "velocity" in name)
    for row, start in enumerate(starts):
        entry = movable[row % len(movable)]
        sign = rng.choice([-1, 1])
        start[entry] = sign * (MAX_MAGNITUDE - rng.choice([0, 0.0625, 0.5, 3]))
        rate = rates.get(entry, first_velocity)
        start[rate] += sign * rng.uniform(0, 3)
    return starts


@pytest.mark.parametrize("name", ["pendulum-50", "truck-50", "lander-50"])
def test_a_returned_state_is_accepted_by_the_next_call(name: str, backend: str):
    emulator = load_emulator(name)
    idle = np.repeat(emulator.bounds.idle[None], STEPS, axis=0)
    told = []
    for start in starts_near_the_end(emulator, 12):
        try:
            path = np.asarray(emulator.rollout(start, idle))
            scored, _ = emulator.rollout_trusted(start, idle)
            rows = np.asarray(emulator.rollout(start[None], idle[None]))[0]
            single = np.asarray(emulator.step(start, idle[0]))
        except (ArgumentError, DivergedError) as error:
            told.append(str(error))
            continue
        for states in (path, scored, rows, single[None]):
            assert (np.abs(states) <= MAX_MAGNITUDE).all()
        emulator.step(path[-1], idle[0])
    assert told
    assert all("beyond 1e+06" in error for error in told)
