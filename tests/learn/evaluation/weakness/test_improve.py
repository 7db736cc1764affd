"""Learning where it is weak: resumed to the same bytes, nothing known is lost, and nothing is simulated for nothing."""

from __future__ import annotations

import errno
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import jax
import numpy as np
import pytest
from conftest import Cli
from small_trainings import small_training

from neuroanimator import (
    DatasetConfig,
    Emulator,
    ImprovementConfig,
    NeuroAnimatorError,
    TrainingConfig,
    improve,
    load_emulator,
    load_system,
    train,
)
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.errors import BadFileError, ResourceError
from neuroanimator.learn.data.config import MAX_UNROLL
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.held_out import held_out_runs
from neuroanimator.learn.evaluation.weakness.improve import Improvement
from neuroanimator.learn.evaluation.weakness.learning import (
    GROUPS,
    MAX_USUAL_GROWTH,
    cut_windows,
    error_on,
    mix_windows,
    widen,
)
from neuroanimator.learn.evaluation.weakness.sampling import (
    RunBatch,
    distributions_of,
    draw_runs,
    expected_errors,
    rate_entries,
)
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.learn.training.train import run_folder
from neuroanimator.physics.functions.step_file import run_file
from neuroanimator.physics.loading import resolve
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems import trusted_files

CONFIG = ImprovementConfig(samples=900, rounds=2, updates=250)
OPTIONS = ["--samples", "900", "--rounds", "2", "--updates", "250"]
UNREACHABLE = 1e-9
"""A tolerance that no emulator keeps, so that every round is gone through."""


class KilledError(Exception):
    """Stands for a kill at a moment that a test chooses."""


@pytest.fixture(scope="module")
def weak(transitions: Transitions, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny emulator, hardly trained."""
    out = tmp_path_factory.mktemp("weak") / "weak.emulator.safetensors"
    train(transitions, TrainingConfig(widths=(16,), updates=1000, batch=128), out)
    return out


@pytest.fixture(scope="module")
def whole(weak: Path, transitions: Transitions) -> tuple[Path, Improvement]:
    """Two rounds of improvement at one go."""
    out = weak.with_name("whole.safetensors")
    emulator = load_emulator(weak)
    return out, improve(emulator, out, tolerance=UNREACHABLE, config=CONFIG, data=transitions)


def bytes_of(out: Path) -> dict[str, bytes]:
    """Return the result, and what each round left."""
    files = [out, *run_folder(out).glob("*.safetensors")]
    return {path.name.replace(out.name, "result"): path.read_bytes() for path in files}


@pytest.mark.endurance
def test_f02_stopped_in_every_round_it_ends_with_the_same_bytes(
    weak: Path, transitions: Transitions, whole: tuple[Path, Improvement], tmp_path: Path
):
    out = tmp_path / "broken.safetensors"
    emulator = load_emulator(weak)

    def go(stops_at: int) -> None:
        def on_round(number: int, errors: Mapping[str, float]) -> None:
            if number == stops_at:
                raise KilledError

        improve(
            emulator,
            out,
            tolerance=UNREACHABLE,
            config=CONFIG,
            data=transitions,
            on_round=on_round,
        )

    for stops_at in (0, 1):
        with pytest.raises(KilledError):
            go(stops_at)
        assert not out.exists()
    go(-1)
    assert bytes_of(out) == bytes_of(whole[0])


def test_f02_killed_within_a_round_it_ends_with_the_same_bytes(
    weak: Path, dataset: Path, whole: tuple[Path, Improvement], tmp_path: Path, cli: Cli
):
    broken = tmp_path / "broken.safetensors"
    options = ["--tolerance", "1e-9", "--data", str(dataset), *OPTIONS]
    program = [sys.executable, "-c", "from neuroanimator.cli.main import main; main()"]
    process = subprocess.Popen(
        [*program, "improve", str(weak), *options, "--out", str(broken)],
        stdout=subprocess.DEVNULL,
    )
    begun = run_folder(broken) / "round-001.emulator.run"
    while process.poll() is None and not begun.exists():
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert not broken.exists()
    done = cli("improve", weak, *options, "--out", broken)
    assert done.returncode == 0, done.stderr
    assert "not every error is at most 1e-09 after 1,800 samples in 2 rounds" in done.stdout
    assert bytes_of(broken) == bytes_of(whole[0])


@pytest.mark.endurance  # tests/faults/test_f04_full_disk.py fills one while data are made
def test_f04_a_disk_that_fills_is_said_and_gone_on_from(
    weak: Path,
    transitions: Transitions,
    whole: tuple[Path, Improvement],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    out = tmp_path / "full.safetensors"
    emulator = load_emulator(weak)
    written = os.fsync
    calls = 0

    def full(handle: int) -> None:
        nonlocal calls
        calls += 1
        if calls % 3 == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written(handle)

    monkeypatch.setattr(os, "fsync", full)
    for _ in range(3):
        with pytest.raises(ResourceError, match=r"Could not write .*: No space left on device"):
            improve(emulator, out, tolerance=UNREACHABLE, config=CONFIG, data=transitions)
    monkeypatch.undo()
    improve(emulator, out, tolerance=UNREACHABLE, config=CONFIG, data=transitions)
    assert bytes_of(out) == bytes_of(whole[0])


def test_a_damaged_round_is_made_again(
    weak: Path, transitions: Transitions, whole: tuple[Path, Improvement], tmp_path: Path
):
    out = tmp_path / "damaged.safetensors"
    shutil.copytree(run_folder(whole[0]), run_folder(out))
    path = run_folder(out) / "round-002.emulator.safetensors"
    path.write_bytes(path.read_bytes()[:-100])
    improve(load_emulator(weak), out, tolerance=UNREACHABLE, config=CONFIG, data=transitions)
    assert bytes_of(out) == bytes_of(whole[0])


def test_more_rounds_go_on_from_fewer(
    weak: Path, transitions: Transitions, whole: tuple[Path, Improvement], tmp_path: Path
):
    out = tmp_path / "more.safetensors"
    emulator = load_emulator(weak)
    fewer = CONFIG.model_copy(update={"rounds": 1})
    first = improve(emulator, out, tolerance=UNREACHABLE, config=fewer, data=transitions)
    assert (first.rounds, first.samples) == (1, 900)
    assert not first.is_within_tolerance
    improve(emulator, out, tolerance=UNREACHABLE, config=CONFIG, data=transitions)
    assert bytes_of(out) == bytes_of(whole[0])


def test_errors_where_it_was_weak_fall_and_usual_ones_stay(
    weak: Path, whole: tuple[Path, Improvement]
):
    usual, shifted = whole[1].errors
    assert (usual.distribution, shifted.distribution) == ("usual", "shifted")
    assert shifted.after < 0.95 * shifted.before
    assert usual.after <= MAX_USUAL_GROWTH * usual.before
    # On runs of another seed, too.
    before = load_emulator(weak)
    test = held_out_runs(before, 32, 2.0, seed=9, scheme=load_system("pendulum").truth)
    errors = [error_on(emulator, test) for emulator in (before, whole[1].emulator)]
    assert errors[1] <= MAX_USUAL_GROWTH * errors[0]


def test_the_improved_emulator_has_a_meter_of_its_own(weak: Path, whole: tuple[Path, Improvement]):
    given, improved = load_emulator(weak), load_emulator(whole[0])
    assert given.meter is not None
    assert improved.meter is not None
    assert not np.array_equal(given.meter.odd, improved.meter.odd)


def test_a_tolerance_that_is_kept_takes_no_sample(
    weak: Path, dataset: Path, tmp_path: Path, cli: Cli
):
    out = tmp_path / "same.safetensors"
    options = ["--data", dataset, "--tolerance", "1000", *OPTIONS]
    done = cli("improve", weak, *options, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "nothing to do: every error is at most 1e+03 already, so no sample was simulated" in (
        done.stdout
    )
    assert not list(run_folder(out).glob("round-*"))
    given, same = (emulator_tensors(load_emulator(path)) for path in (weak, out))
    assert given.keys() == same.keys()
    assert all(np.array_equal(given[name], same[name]) for name in given)


def test_another_emulators_folder_is_refused(
    weak: Path, transitions: Transitions, whole: tuple[Path, Improvement], shipped: Emulator
):
    before = bytes_of(whole[0])
    for emulator, config in (
        (shipped, CONFIG),
        (load_emulator(weak), CONFIG.model_copy(update={"seed": 1})),
    ):
        with pytest.raises(BadFileError, match="holds a run with other data or settings"):
            improve(emulator, whole[0], config=config, data=transitions)
    assert bytes_of(whole[0]) == before


@pytest.mark.parametrize("tolerance", [0.0, -1.0, float("nan"), float("inf")])
def test_a_tolerance_is_a_number_above_zero(tolerance: float, shipped: Emulator, tmp_path: Path):
    with pytest.raises(NeuroAnimatorError, match="tolerance: wanted a number above 0"):
        improve(shipped, tmp_path / "e.safetensors", tolerance=tolerance)
    assert not list(tmp_path.iterdir())


def test_a_controllers_motion_is_a_distribution_of_its_own(
    weak: Path, transitions: Transitions, tmp_path: Path
):
    controls = np.full((30, 3), 4.0)
    result = improve(
        load_emulator(weak),
        tmp_path / "e.safetensors",
        tolerance=1000.0,
        config=CONFIG,
        data=transitions,
        controllers={"push.csv": controls},
    )
    assert [error.distribution for error in result.errors] == ["usual", "shifted", "push.csv"]
    with pytest.raises(NeuroAnimatorError, match=r"push.csv: control: .* out of bounds"):
        improve(
            load_emulator(weak),
            tmp_path / "e.safetensors",
            config=CONFIG,
            data=transitions,
            controllers={"push.csv": 100 * controls},
        )


def test_the_error_expected_is_that_of_runs_with_such_scores():
    rng = np.random.default_rng(0)
    scores = rng.uniform(0.1, 3, (400, 5))
    source = np.repeat([0, 1], 200)
    errors = 0.2 * scores**1.5 * np.where(source == 1, 3.0, 1.0)[:, None]
    weights = expected_errors(scores, errors, source, scores, source)
    assert weights == pytest.approx(errors.mean(axis=1))


def test_a_distribution_that_the_probe_missed_gets_the_others_height():
    scores = np.full((4, 2), 0.5)
    errors = np.full((4, 2), 0.3)
    missed = np.array([1])
    found = expected_errors(scores, errors, np.zeros(4, int), scores[:1], missed)
    assert found == pytest.approx([0.3])


def test_a_run_is_validated_on_in_every_round_or_in_none(transitions: Transitions):
    states = np.random.default_rng(0).normal(size=(90, 16, 6)).astype(np.float32)
    samples = RunBatch(states, np.zeros((90, 15, 3), np.float32), np.zeros(90, int))
    groups = []
    for count in (60, 90):
        data = mix_windows(
            transitions, cut_windows(samples.rows(np.arange(count)), MAX_UNROLL), CONFIG
        )
        assert len(data.states) % GROUPS == 0
        assert len(set(np.bincount(data.run))) == 1
        groups.append(
            {row[0].tobytes(): run for row, run in zip(data.states, data.run, strict=True)}
        )
    common = groups[0].keys() & groups[1].keys()
    assert len(common) > 1000
    assert all(groups[0][key] == groups[1][key] for key in common)


def test_a_wider_range_changes_nothing_within_the_old_one(
    shipped: Emulator, transitions: Transitions
):
    system = transitions.system
    rng = np.random.default_rng(0)
    _, shifted = distributions_of(system, shipped.dt)
    pool = draw_runs([shifted], rng, transitions.states[:, 0].astype(float), 60)
    runs = system.simulate(pool.states[:, 0], 1.0 * pool.controls, shipped.dt)
    wider = widen(shipped, cut_windows(pool._replace(states=runs.states), MAX_UNROLL))
    assert (np.asarray(wider.domain.high) > np.asarray(shipped.domain.high)).any()
    assert jax.numpy.array_equal(wider.domain.low, -wider.domain.high)
    states = transitions.states[:100, 0].astype(float)
    controls = transitions.controls[:100, :1].astype(float)
    covered = shipped.trust(states, controls[:, 0]) < 0.5
    # Controls at their very bounds lie just beyond the old range.
    shown = np.abs(np.asarray(shipped.raw_features_of(states, controls[:, 0])))
    covered &= (shown <= np.asarray(shipped.domain.high)).all(axis=1)
    assert covered.sum() > 50
    expected = shipped.rollout(states[covered], controls[covered])
    assert np.array_equal(wider.rollout(states[covered], controls[covered]), expected)


def test_a_faster_body_is_within_wider_limits():
    fish = load_emulator("fish-50")
    states = np.tile(fish.rest, (50, 5, 1)).astype(np.float32)
    rates = rate_entries(load_system("fish"))
    states[..., rates] += np.linspace(0, 10, 50, dtype=np.float32)[:, None, None]
    windows = RunBatch(states, np.zeros((50, 4, 12), np.float32), np.arange(50))
    before, after = (
        np.asarray(emulator.encoding.limits) for emulator in (fish, widen(fish, windows))
    )
    assert (after >= before).all()
    assert after.sum() > before.sum() + 5


STEP_FILE = """
import numpy as np

STEP = 0.01
STATE = {"angle": "rad", "speed": "rad/s"}
CONTROL = {"torque": ("N·m", -2.0, 2.0)}
RATES = {"angle": "speed"}
SPREAD = {"angle": 1.0, "speed": 2.0}
BATCHED = True

def step(state, control, dt):
    speed = state[1] + dt * (control[0] - 9.81 * np.sin(state[0]))
    return np.array([state[0] + dt * speed, speed])
"""


def test_a_function_that_may_not_run_is_refused_with_what_to_do(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "swing.py").write_text(STEP_FILE)
    toml, _ = write_definition(str(tmp_path / "swing.py"))
    name, definition, substeps = resolve(str(toml))
    data = simulate_transitions(
        DatasetConfig(system=name, definition=definition, substeps=substeps, count=360)
    )
    build_emulator(data, TrainingConfig(widths=(8,))).save(tmp_path / "e.safetensors")
    monkeypatch.setattr(trusted_files, "_TRUSTED", {})
    run_file.cache_clear()
    refused = cli("improve", "e.safetensors", "--out", "f.safetensors", cwd=tmp_path)
    assert refused.returncode == 3
    assert "give the TOML file beside it, --system PATH" in refused.stderr
    assert len(refused.stderr.splitlines()) == 1


def test_recordings_are_not_simulated_and_from_is_told_of(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
):
    rows = [f"{k * 0.02:.2f},{math.sin(k)},{math.cos(k)}" for k in map(float, range(2000))]
    header = "time s,state.angle rad,control.torque N·m"
    (tmp_path / "recorded.csv").write_text("\n".join([header, *rows, ""]))
    monkeypatch.chdir(tmp_path)
    toml, _ = write_definition("recorded.csv")
    small = [
        *small_training(250, "8", 64),
        "--out",
        "e.emulator.safetensors",
    ]
    assert cli("train", toml, *small).returncode == 0
    refused = cli("improve", "e.emulator.safetensors", "--out", "f.emulator.safetensors")
    assert refused.returncode == 2
    assert "cannot be simulated" in refused.stderr
    assert "improve --from recording.csv" in refused.stderr
