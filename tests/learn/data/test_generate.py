"""Datasets are the same bytes however they were made."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import (
    DatasetConfig,
    NeuroAnimatorError,
    generate,
    load_emulator,
    load_system,
    read_transitions,
)
from neuroanimator.definitions.parts import GaitTable
from neuroanimator.learn.data.config import MAX_GAP, MAX_UNROLL, RUN_STEPS
from neuroanimator.learn.data.sampling import with_held_runs
from neuroanimator.learn.data.shard import make_shard, sample_steps
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds
from neuroanimator.systems.random_controls import sample_control_runs, sample_controls


def fingerprint(folder: Path) -> dict[str, str]:
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.glob("*.*s*"))
    }


@pytest.mark.parametrize(("count", "largest"), [(12, MAX_GAP), (18, 3), (24, 2), (36, 1)])
def test_samples_lie_one_to_five_super_steps_apart_and_leave_room_to_unroll(
    count: int, largest: int
):
    rng = np.random.default_rng(0)
    samples = np.stack([sample_steps(rng, count) for _ in range(500)])
    gaps = np.diff(samples, axis=1)
    assert set(np.unique(gaps)) == set(range(1, largest + 1))
    assert samples.min() >= 0
    assert samples.max() + MAX_UNROLL <= RUN_STEPS


def test_a_window_is_what_the_physics_does(transitions):
    rows = np.arange(0, len(transitions.states), 500)
    runs = transitions.system.simulate(
        transitions.states[rows, 0], transitions.controls[rows], 0.05
    )
    np.testing.assert_allclose(runs.states[:, 1], transitions.states[rows, 1], atol=2e-3)


def test_controls_are_bounded_and_never_idle():
    bounds, rng = Bounds((-30.0, 0.0, -4.0), (30.0, 14.0, 2.0)), np.random.default_rng(0)
    for _ in range(300):
        controls = sample_controls(rng, 40, 0.05, bounds)
        assert (bounds.clip(controls) == controls).all()
        assert (np.abs((controls - bounds.middle) / bounds.half).max(axis=0) > 1e-3).all()


@pytest.mark.parametrize("name", ["pendulum", "fish"])
def test_an_emulator_is_driven_by_the_same_random_controls_as_its_system(name: str):
    system, spec = load_system(name), load_emulator(f"{name}-50").spec
    own, emulator_states = (
        sample_control_runs(np.random.default_rng(0), 20, 40, 0.05, driven)
        for driven in (system, spec)
    )
    assert own.shape == (20, 40, system.control.size)
    np.testing.assert_array_equal(own, emulator_states)
    assert len(np.unique(own, axis=0)) == 20


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_gait_has_its_share_of_the_runs_and_an_emulator_knows_it(share: float):
    bounds = Bounds((-1.0,) * 2, (1.0,) * 2)
    gait = Gait(0.5, (0.5, 0.5), (0.0, np.pi), share)
    assert Gait.from_json(gait.to_json(), 2) == gait
    table = GaitTable(period=0.5, controls={"left": (0.5, 0.0)}, share=share)
    assert table.model_dump()["share"] == share
    rng = np.random.default_rng(0)
    by_gait = []
    for _ in range(400):
        controls = sample_controls(rng, 60, 0.05, bounds, gait)
        by_gait.append(np.corrcoef(controls.T)[0, 1] < -0.8)  # half a period apart
    assert np.mean(by_gait) == pytest.approx(0.75 * share, abs=0.2)


def test_a_usual_share_leaves_definitions_and_with_them_datasets_as_they_were():
    table = GaitTable(period=0.5, controls={"left": (0.5, 0.0)})
    assert table.share == 0.4
    assert table.model_dump(mode="json") == {"period": 0.5, "controls": {"left": [0.5, 0.0]}}


def test_a_run_that_diverges_is_dropped_and_counted():
    system = load_system("pendulum")
    system.sample_starts = lambda rng, count: np.full((count, 6), 1e4)
    shard = make_shard(system, DatasetConfig(system="pendulum", count=120), 0, threads=1)
    assert shard.diverged == 10
    assert len(shard.tensors["states"]) == 0
    assert (shard.starts == 1e4).all()


def test_a_folder_of_another_configuration_is_refused_and_untouched(dataset: Path):
    before = fingerprint(dataset)
    with pytest.raises(NeuroAnimatorError, match="holds another dataset .*seed 0 there, 1 asked"):
        generate(DatasetConfig(system="pendulum", count=6000, seed=1), dataset)
    assert fingerprint(dataset) == before


def test_a_damaged_shard_is_reported_when_read_and_made_again_by_generate(
    dataset: Path, tmp_path: Path
):
    before = fingerprint(dataset)
    for path in dataset.glob("*.*s*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    shard = tmp_path / "shard-00001.safetensors"
    shard.write_bytes(shard.read_bytes()[:-10])
    with pytest.raises(NeuroAnimatorError, match="shard-00001"):
        read_transitions(tmp_path)
    shard.unlink()
    with pytest.raises(NeuroAnimatorError, match="Could not read .*shard-00001"):
        read_transitions(tmp_path)
    generate(DatasetConfig(system="pendulum", count=6000), tmp_path)
    assert fingerprint(tmp_path) == before


@pytest.mark.parametrize(
    ("field", "value"),
    [("substeps", 0), ("count", 0), ("seed", -1), ("substeps", 2.5), ("unknown", 1)],
)
def test_bad_settings_are_refused_by_field(field: str, value: float):
    with pytest.raises(NeuroAnimatorError, match=field):
        DatasetConfig(**({"system": "pendulum"} | {field: value}))


def test_a_super_step_that_physics_cannot_divide_is_refused():
    with pytest.raises(NeuroAnimatorError, match="not a whole number"):
        DatasetConfig(system="pendulum", substeps=7)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_a_share_of_runs_holds_controls_at_their_bounds(share: float):
    system = load_system("truck")
    rng = np.random.default_rng(0)
    starts = np.repeat(system.rest[None], 40, axis=0)
    controls = sample_control_runs(rng, len(starts), 40, 0.1, system)
    begin, held = with_held_runs(system, rng, starts, controls, share)
    bounds = system.bounds
    at_ends = np.isin(held, [*bounds.low, *bounds.high, *bounds.idle]).all(axis=2)
    is_held = at_ends[:, :20].all(axis=1) & (held[:, :20] == held[:, :1]).all(axis=(1, 2))
    assert is_held.mean() == pytest.approx(share, abs=0.15)
    np.testing.assert_array_equal(held[~is_held], controls[~is_held])
    np.testing.assert_array_equal(begin[~is_held], starts[~is_held])
    if share == 1:
        speeds = np.linalg.norm(system.state.part(begin, "root.velocity"), axis=1)
        assert speeds.max() > 5  # m/s: nearly the highest, before the run begins


@pytest.mark.parametrize("name", ["cube", "pendulum-passive"])
def test_pushes_are_not_held_for_a_whole_run(name: str):
    """A cube of 2 kg flew at 20 m/s."""
    system = load_system(name)
    rng = np.random.default_rng(0)
    starts = np.repeat(system.rest[None], 10, axis=0)
    controls = sample_control_runs(rng, len(starts), 40, 0.1, system)
    begin, held = with_held_runs(system, rng, starts, controls, 1.0)
    assert begin is starts
    assert held is controls
