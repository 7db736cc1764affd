"""A verdict's causes: where the error sits, contacts, samples outside the training data, and what the data lack."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from neuroanimator import DatasetConfig, TrainingConfig
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.verdict import GOOD, POOR, Verdict
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.shortcomings import (
    PER_NUMBER,
    shortcomings,
    shortcomings_of,
    too_few,
    wilder_test,
    without_velocities,
)
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.component_errors import ComponentError
from neuroanimator.learn.evaluation.held_out import HeldOut, make_test
from neuroanimator.learn.evaluation.weakness.causes import (
    Extrapolation,
    StepErrors,
    causes_in_training,
    concentrated,
    largest_part,
    weak_spots,
)


def components(relative: list[float]) -> list[ComponentError]:
    found = []
    for number, error in enumerate(relative):
        found.append(ComponentError(f"part[{number}]", "m", error, error, 1.0, error))
    return found


@pytest.mark.parametrize("where", range(4))
def test_the_part_with_most_of_the_error_is_named(where: int):
    relative = [0.1] * 4
    relative[where] = 1.0
    assert largest_part(components(relative)) == f"97% of the error is in part[{where}]"
    assert not largest_part(components([0.1] * 4))


def test_samples_outside_the_training_data_count_if_they_are_many_and_worse():
    alike = Extrapolation(50, 0.2, 3.0).cause
    assert "20% of the unseen samples are outside the training data" in alike
    assert not Extrapolation(50, 0.2, 1.1).cause
    assert not Extrapolation(1, 0.01, 9.0).cause


def test_positions_without_velocities_are_a_cause():
    assert "state.angle: no column" in without_velocities(["state.angle"], ["rad"], [])
    assert not without_velocities(["a", "b"], ["rad", "rad/s"], [])
    assert not without_velocities(["a", "b"], ["rad", "1"], [0])
    assert not without_velocities(["a", "b"], ["K", "1"], [])


@pytest.mark.parametrize("seed", range(20))
def test_too_few_super_steps_are_those_below_a_hundred_a_number(seed: int):
    rng = np.random.default_rng(seed)
    numbers = int(rng.integers(1, 300))
    steps = int(rng.integers(0, 2 * PER_NUMBER * numbers))
    assert bool(too_few(steps, numbers, "more")) == (steps < PER_NUMBER * numbers)


@pytest.mark.parametrize("seed", range(20))
def test_a_wilder_test_is_told_by_name_wherever_its_middle_is(seed: int):
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=3) * 100
    learnt = rng.uniform(-1, 1, (500, 3))
    tested = rng.uniform(-1, 1, (100, 3))
    wild = int(rng.integers(3))
    names = ["a", "b", "c"]
    units = [str(rng.choice(["rad", "m", "rad/s"])) for _ in names]
    assert not wilder_test(names, units, learnt + middle, tested + middle)
    is_angle = np.array(units) == "rad"
    turned = tested + 2 * np.pi * rng.integers(-9, 9, 3) * is_angle
    assert not wilder_test(names, units, learnt + middle, turned + middle)
    tested[:, wild] *= 2 if is_angle[wild] else rng.uniform(2, 50)
    told = wilder_test(names, units, learnt + middle, tested + middle)
    assert told.startswith(f"{names[wild]} (")
    assert told.count(" times as far") == 1


@cache
def landings() -> tuple[HeldOut, np.ndarray, np.ndarray]:
    """Return super steps of landers in the air, on the ground, or landing; the run of each, and whether it touches."""
    data = simulate_transitions(DatasetConfig(system="lander", substeps=5, count=1080))
    test = make_test(
        data.system, 5 * data.system.physics_dt, data.states[:, :2], data.controls[:, :1]
    )
    contacts = data.system.contact_counts(data.states[:, 0])
    assert contacts is not None
    return test, data.run, contacts > 0


@pytest.mark.parametrize("kind", ["touching", "everywhere"])
def test_an_error_that_sits_at_contacts_is_said_to_be_there(kind: str):
    test, runs, is_touching = landings()
    assert 0.04 < is_touching.mean() < 0.5
    holds = is_touching if kind == "touching" else np.ones(len(runs), bool)
    relative = np.where(holds, 1.0, 1e-2)[:, None] * np.ones(int(test.moves.sum()))
    errors = np.zeros((len(runs), len(test.moves)))
    found = StepErrors(test.transitions, errors, relative, np.zeros(len(runs)))
    told = concentrated(weak_spots(test, found, runs))
    assert ("where contacts > 0" in told) == (kind == "touching")


@pytest.fixture(scope="module")
def small() -> Transitions:
    return simulate_transitions(DatasetConfig(system="pendulum", substeps=50, count=240))


def test_data_say_before_training_that_they_are_few(small: Transitions):
    enough = DatasetConfig(system="pendulum", substeps=50, count=5_000)
    assert not shortcomings_of(enough, small.system)
    [told] = shortcomings(small)
    assert told.startswith("only 800 super steps to learn 9 numbers from, wanted about 900")
    assert "--count" in told


def test_the_verdict_at_the_end_of_training_has_causes(small: Transitions, shipped: Emulator):
    causes = causes_in_training(shipped, small, TrainingConfig())
    assert any(cause.startswith("only 800 super steps") for cause in causes)
    poor = Verdict(POOR, ("it is off",)).because(causes)
    assert "it is off; only 800 super steps" in str(poor)
    assert Verdict(GOOD, ("it is exact",)).because(causes).reasons == ("it is exact",)
