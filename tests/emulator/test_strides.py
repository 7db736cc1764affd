"""A super step in strides is so many super steps of the shorter emulator, whatever runs it."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import numpy as np
import pytest

from neuroanimator import Emulator, TrainingConfig, load_emulator, load_system
from neuroanimator.emulator.artifact import read_metadata
from neuroanimator.emulator.c_emulator import c_emulator
from neuroanimator.emulator.description import blank, describe
from neuroanimator.emulator.spec import MAX_STRIDES
from neuroanimator.errors import ArgumentError
from neuroanimator.files.zoo import LARGE, emulator_name, shipped_path
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.evaluation.accuracy import one_step_error, root_mean_square
from neuroanimator.learn.evaluation.held_out import make_test
from neuroanimator.learn.training.train import train
from neuroanimator.systems.random_controls import sample_control_runs

STEPS = 12
RUNS = 32
CLOSE = 1e-4
"""Of the largest number of a state: both are float32, and differences add up over a motion."""


def controls_for(emulator: Emulator) -> np.ndarray:
    """Return random controls (STEPS, C)."""
    shares = np.random.default_rng(0).uniform(-1, 1, (STEPS, emulator.control.size))
    return emulator.bounds.middle + shares * emulator.bounds.half


def assert_close(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, atol=CLOSE * np.abs(expected).max())


@pytest.mark.parametrize("name", ["pendulum-25", "fish-25"])
def test_two_strides_are_two_super_steps_under_one_control(name: str):
    short = load_emulator(name)
    long = short.in_strides(2)
    controls = controls_for(long)
    one_by_one = short.rollout(short.rest, np.repeat(controls, 2, axis=0))
    assert_close(long.rollout(long.rest, controls), one_by_one[::2])
    assert (long.substeps, long.dt) == (50, pytest.approx(2 * short.dt))


def test_in_c_strides_are_those_of_jax():
    emulator = load_emulator("pendulum-25").in_strides(3)
    if c_emulator(emulator) is None:
        pytest.skip("no C compiler")
    controls = controls_for(emulator).astype(np.float32)
    start = emulator.rest.astype(np.float32)
    in_jax = np.asarray(emulator.rollout(jax.numpy.asarray(start), jax.numpy.asarray(controls)))
    assert_close(emulator.rollout(start, controls), in_jax)


def test_strides_survive_a_file(tmp_path: Path):
    emulator = load_emulator("lander-25").in_strides(2)
    emulator.save(tmp_path / "it.safetensors")
    loaded = load_emulator(tmp_path / "it.safetensors")
    assert loaded.strides == 2
    assert "in 2 strides" in repr(loaded)
    controls = controls_for(emulator)
    np.testing.assert_array_equal(
        loaded.rollout(loaded.rest, controls), emulator.rollout(emulator.rest, controls)
    )


def test_a_single_stride_is_not_written_down():
    assert "strides" not in describe(load_emulator("pendulum-25"))


def test_there_are_not_too_many_strides():
    emulator = load_emulator("pendulum-25")
    for count in (0, MAX_STRIDES + 1):
        with pytest.raises(ArgumentError, match="strides in all"):
            emulator.in_strides(count)
    metadata = describe(emulator)
    for strides in (0, MAX_STRIDES + 1, "2", 1.5, True):
        with pytest.raises((ValueError, TypeError)):
            blank(json.loads(json.dumps(metadata | {"strides": strides})), Emulator)


def errors_of(*emulators: Emulator) -> list[float]:
    """Return the one-step error of each on the same runs."""
    dt = emulators[0].dt
    system = load_system(emulators[0].system)
    rng = np.random.default_rng(0)
    starts = system.sample_starts(rng, RUNS)
    controls = sample_control_runs(rng, RUNS, STEPS, dt, system)
    runs = system.simulate_fastest(starts, controls, dt, scheme=system.truth)
    test = make_test(system, dt, runs.states, controls)
    return [float(root_mean_square(one_step_error(emulator, test))) for emulator in emulators]


@pytest.mark.parametrize(("system", "substeps"), LARGE)
def test_the_large_size_is_more_exact(system: str, substeps: int):
    usual = load_emulator(emulator_name(system, substeps))
    large = load_emulator(emulator_name(system, substeps, "large"))
    assert (large.system, large.substeps) == (system, substeps)
    of_large, of_usual = errors_of(large, usual)
    assert of_large < of_usual


def test_the_large_size_ships_small():
    for row in LARGE:
        path = shipped_path(*row, "large")
        assert path.stat().st_size < 1_000_000
        assert read_metadata(path)["provenance"]["training"]["seed"] == 0


@pytest.mark.endurance
def test_a_cube_that_turns_far_in_a_super_step_is_followed(tmp_path: Path):
    # Spinning at 20 rad/s it turns by more than half a turn in 0.2 s, which no rotation vector can say. Trained as
    # briefly, one leap over 0.2 s has an error of 0.51, and linear regression 0.76.
    data = simulate_transitions(DatasetConfig(system="cube", count=1800, samples_per_run=36))
    config = TrainingConfig(
        network="linear-glu",
        widths=(32,),
        updates=500,
        batch=128,
        position_modes=18,
        velocity_modes=18,
    )
    emulator = train(data, config, tmp_path / "cube.emulator.safetensors").in_strides(2)
    assert emulator.substeps == 100
    assert errors_of(emulator)[0] < 0.45
