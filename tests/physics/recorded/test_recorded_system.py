"""Recordings become a dataset and an emulator, and what is wrong with them is told by line."""

from __future__ import annotations

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli
from small_trainings import small_training

from neuroanimator import (
    DatasetConfig,
    Emulator,
    NeuroAnimatorError,
    TrainingConfig,
    evaluate,
    generate,
    load_system,
    read_transitions,
    train,
    write_report,
)
from neuroanimator.definitions import carried
from neuroanimator.errors import BadFileError
from neuroanimator.learn.data import config
from neuroanimator.learn.data.config import window_length
from neuroanimator.learn.data.recorded_segments import limited_to_recordings, split_recordings
from neuroanimator.learn.evaluation.evaluate import EvaluationBudget
from neuroanimator.physics.loading import resolve
from neuroanimator.physics.recorded.read_recordings import read_recordings
from neuroanimator.physics.recorded.recorded_system import RecordedSystem
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.recording_file import RecordingFile

HEADER = "run,time s,state.angle rad,state.speed rad/s,control.torque N·m"
SUBSTEPS = 5


def recordings(runs: int = 6, rows: int = 400) -> np.ndarray:
    """Return rows (run, time, angle, speed, torque) of a linear oscillator under a smooth torque, at 50 Hz."""
    rng, table = np.random.default_rng(3), []
    for run in range(runs):
        angle, speed, phase = rng.uniform(-0.5, 0.5), 0.0, rng.uniform(0, 6, 3)
        for k in range(rows):
            torque = np.sin(0.02 * k * np.array([1.0, 2.3, 4.1]) + phase).sum()
            table.append((run, k * 0.02, angle, speed, torque))
            for _ in range(20):
                speed += 0.001 * (6 * torque - 16 * angle - speed)
                angle += 0.001 * speed
    return np.array(table)


def write_csv(path: Path, table: np.ndarray) -> None:
    lines = [
        ",".join([str(int(row[0])), *(repr(float(value)) for value in row[1:])]) for row in table
    ]
    path.write_text("\n".join([HEADER, *lines, ""]))


def write_npz(path: Path, table: np.ndarray, **changes: object) -> None:
    arrays: dict[str, object] = {
        "run": table[:, 0].astype(int),
        "time": table[:, 1],
        "states": table[:, 2:4],
    }
    arrays |= {
        "controls": table[:, 4:],
        "state_names": ["angle rad", "speed rad/s"],
        "control_names": ["torque N*m"],
    }
    np.savez(path, **{key: np.asarray(value) for key, value in (arrays | changes).items()})  # pyright: ignore


def system_from(path: Path) -> RecordedSystem:
    toml, _ = write_definition(str(path), force=True)
    system = load_system(*resolve(str(toml))[:2])
    assert isinstance(system, RecordedSystem)
    return system


def recordings_from(path: Path) -> RecordingFile:
    recordings = system_from(path).recordings
    assert recordings is not None
    return recordings


def dataset_from(system: RecordedSystem, folder: Path, **changes: int) -> Path:
    settings = {"substeps": SUBSTEPS, "count": 100_000} | changes
    generate(
        DatasetConfig(system=system.name, definition=system.definition_text, **settings), folder
    )
    return folder


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    return recordings()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, table: np.ndarray) -> Path:
    """A folder with runs.csv, runs.toml and data."""
    folder = tmp_path_factory.mktemp("recorded")
    write_csv(folder / "runs.csv", table)
    dataset_from(system_from(folder / "runs.csv"), folder / "data")
    return folder


def rows_of(table: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return the row of the table each state (N, S) was recorded in; -1 if in none."""
    known = {tuple(row): k for k, row in enumerate(table[:, 2:4].astype(np.float32).tolist())}
    return np.array([known.get(tuple(state), -1) for state in states.astype(np.float32).tolist()])


def test_every_number_of_the_dataset_is_one_of_the_recording(folder: Path, table: np.ndarray):
    data = read_transitions(folder / "data")
    rows = rows_of(table, data.states.reshape(-1, 2)).reshape(data.states.shape[:2])
    assert rows.min() >= 0
    assert (np.diff(rows, axis=1) == SUBSTEPS).all()
    assert len(np.unique(rows[:, 0] % SUBSTEPS)) == SUBSTEPS
    assert len(np.unique(rows[:, 0])) == len(rows)
    held = table[rows[:, :-1, None] + np.arange(SUBSTEPS), 4].mean(axis=-1)
    np.testing.assert_allclose(data.controls[..., 0], held, rtol=1e-5, atol=1e-6)


def test_segments_share_no_sample_and_the_test_is_never_trained_on(folder: Path, table: np.ndarray):
    data = read_transitions(folder / "data")
    assert data.held_out is not None
    rows = rows_of(table, data.states.reshape(-1, 2)).reshape(data.states.shape[:2])
    used = {
        int(run): range(rows[data.run == run].min(), rows[data.run == run].max() + 1)
        for run in set(data.run)
    }
    tested = set(rows_of(table, data.held_out[0].reshape(-1, 2)).tolist())
    seen: set[int] = set()
    for samples in used.values():
        assert seen.isdisjoint(samples)
        seen |= set(samples)
        assert len({int(table[row, 0]) for row in samples}) == 1
    assert seen.isdisjoint(tested)
    assert -1 not in tested


def test_csv_and_npz_make_the_same_dataset(folder: Path, table: np.ndarray, tmp_path: Path):
    write_npz(tmp_path / "runs.npz", table)
    dataset_from(system_from(tmp_path / "runs.npz"), tmp_path / "data")
    first, second = read_transitions(folder / "data"), read_transitions(tmp_path / "data")
    np.testing.assert_array_equal(first.states, second.states)
    np.testing.assert_array_equal(first.controls, second.controls)
    np.testing.assert_array_equal(first.run, second.run)


def test_a_dataset_that_was_cut_in_another_way_is_made_again(
    folder: Path, table: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    write_csv(tmp_path / "runs.csv", table)
    system = system_from(tmp_path / "runs.csv")
    with monkeypatch.context() as earlier:
        earlier.setattr(carried, "SPLIT", carried.SPLIT - 1)
        config._identity_of.cache_clear()
        dataset_from(system, tmp_path / "data")
    config._identity_of.cache_clear()
    with pytest.raises(BadFileError, match="another dataset"):
        read_transitions(tmp_path / "data")
    dataset_from(system, tmp_path / "data")
    for path in folder.glob("data/*.safetensors"):
        assert (tmp_path / "data" / path.name).read_bytes() == path.read_bytes()


def test_a_lost_shard_is_made_again_with_the_same_bytes(folder: Path):
    shard = folder / "data" / "shard-00000.safetensors"
    before = shard.read_bytes()
    shard.unlink()
    dataset_from(system_from(folder / "runs.csv"), folder / "data")
    assert shard.read_bytes() == before


def test_an_emulator_of_a_linear_system_is_accurate_on_recordings_it_has_not_seen(
    folder: Path, tmp_path: Path
):
    data = read_transitions(folder / "data")
    out = tmp_path / "runs.emulator.safetensors"
    train(data, TrainingConfig(updates=750, widths=(24, 24), batch=128), out)
    found = evaluate(
        Emulator.load(out), data=data, budget=EvaluationBudget(repeats=3, starts=20, steps=50)
    )
    assert found.one_step_error < 0.05
    assert found.one_step_error < 0.2 * found.baselines["persistence"]
    assert found.diverged == 0
    assert found.row()["nominal_speedup"] == "none"
    assert "no physics to compare its speed with" in found.note
    with pytest.raises(NeuroAnimatorError, match="no speed-ups"):
        _ = found.speed
    with pytest.raises(NeuroAnimatorError, match="--data"):
        evaluate(Emulator.load(out))
    write_report([found], tmp_path / "report.html")
    assert "no physics to compare" in (tmp_path / "report.html").read_text()


def test_what_the_columns_show_is_proposed(folder: Path):
    system = load_system(*resolve(str(folder / "runs.toml"))[:2])
    assert system.structure.rates == ((0, 1),)
    assert system.physics_dt == 0.02
    assert system.control.names == ["torque[0] N·m"]


def test_an_angle_that_jumps_over_a_half_turn_goes_on(tmp_path: Path, table: np.ndarray):
    turning = table.copy()
    turning[:, 2] = (table[:, 1] * 3 + np.pi) % (2 * np.pi) - np.pi
    turning[:, 3] = 3.0
    write_csv(tmp_path / "turns.csv", turning)
    system = system_from(tmp_path / "turns.csv")
    data = read_transitions(dataset_from(system, tmp_path / "data"))
    assert system.structure.rates == ((0, 1),)
    np.testing.assert_allclose(np.diff(data.states[..., 0], axis=1), 3 * 0.02 * SUBSTEPS, atol=1e-4)


def test_recordings_are_not_simulated(folder: Path):
    system = load_system(*resolve(str(folder / "runs.toml"))[:2])
    with pytest.raises(NeuroAnimatorError, match="recordings cannot be simulated"):
        system.simulate(np.zeros((1, 2)), np.zeros((1, 1, 1)), 0.1)


@pytest.mark.endurance
def test_the_command_line_goes_all_the_way(folder: Path, cli: Cli, tmp_path: Path):
    (tmp_path / "runs.csv").write_bytes((folder / "runs.csv").read_bytes())
    emulator = "runs.emulator.safetensors"
    for arguments in (
        ("new", "runs.csv"),
        ("generate", "runs.toml", "--out", "data"),
        ("train", "data", *small_training(250, "8", 64), "--out", emulator),
        ("evaluate", emulator, "--data", "data"),
        ("animate", emulator, "--out", "clip.csv"),
    ):
        result = cli(*arguments, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
    assert (tmp_path / "clip.csv").read_text().startswith("time s,angle[0] rad,speed[0] rad/s")
    refused = cli("animate", emulator, "--out", "clip.obj", cwd=tmp_path)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert cli("new", "runs.csv", cwd=tmp_path).returncode == 2


GOOD = [HEADER, "0,0.00,0.1,0,1", "0,0.02,0.2,0,2", "0,0.04,0.3,0,1"]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "bad.csv is empty"),
        (GOOD[1:], "bad.csv, line 1: no column 'time s'"),
        (GOOD[:1], "bad.csv: 0 rows"),
        (
            [*GOOD, "0,0.07,0.4,0,1"],
            "bad.csv, line 5, time: 0.03 s after the row before, elsewhere 0.02 s",
        ),
        (
            [*GOOD, "0,0.06,nan,0,1"],
            "bad.csv, line 5, column 3 (state.angle rad): wanted a finite number, got 'nan'",
        ),
        ([*GOOD, "0,0.06,0.4,inf,1"], "bad.csv, line 5, column 4"),
        (
            [*GOOD, "0,0.06,1_0,0,1"],
            "column 3 (state.angle rad): wanted a finite number, got '1_0'",
        ),
        ([*GOOD, "0,0.06,0.4,٣,1"], "bad.csv, line 5, column 4"),
        ([*GOOD, "0,0.06,0.4,0,on"], "bad.csv, line 5, column 5 (control.torque N·m)"),
        ([*GOOD, "0,0.06,0.4,0"], "bad.csv, line 5: 4 cells; wanted 5"),
        (
            [GOOD[0].replace("rad/s", "knots"), *GOOD[1:]],
            "bad.csv, line 1, column 4: unknown unit 'knots'",
        ),
        (
            [GOOD[0].replace("speed rad/s", "speed"), *GOOD[1:]],
            "line 1, column 4: wanted a name and a unit",
        ),
        (
            [GOOD[0].replace("speed rad/s", "angle rad"), *GOOD[1:]],
            "two columns are called 'state.angle'",
        ),
        ([GOOD[0].replace("control.", "motor."), *GOOD[1:]], "'motor.torque N·m' is none of run"),
        ([HEADER.replace("state.", "control."), *GOOD[1:]], "no state column"),
        ([HEADER, *(f"0,{k / 50},{k},0,1" for k in range(99))], "control.torque never changes"),
    ],
)
def test_a_bad_table_is_refused_by_line(tmp_path: Path, lines: list[str], message: str):
    (tmp_path / "bad.csv").write_text("\n".join(lines))
    with pytest.raises(BadFileError) as caught:
        write_definition(str(tmp_path / "bad.csv"))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "bad.toml").exists()


def test_a_missing_file_is_refused(tmp_path: Path):
    with pytest.raises(BadFileError, match="Could not read .*nowhere.csv"):
        write_definition(str(tmp_path / "nowhere.csv"))


@pytest.mark.parametrize(
    ("rows", "message"),
    [(18, "the longest run has 18 rows; wanted at least 21"), (40, "40 rows are too few")],
)
def test_runs_too_short_or_too_few_are_refused(tmp_path: Path, rows: int, message: str):
    write_csv(tmp_path / "bad.csv", recordings(runs=1, rows=rows))
    write_csv(tmp_path / "good.csv", recordings(runs=1, rows=400))
    with pytest.raises(BadFileError, match="too few to learn from"):
        system_from(tmp_path / "bad.csv")
    # Who edits the proposal for long recordings may have short ones.
    system_from(tmp_path / "good.csv")
    toml = tmp_path / "bad.toml"
    toml.write_text((tmp_path / "good.toml").read_text().replace("good", "bad"))
    system = load_system(*resolve(str(toml))[:2])
    config = DatasetConfig(system=system.name, definition=system.definition_text, substeps=SUBSTEPS)
    with pytest.raises(BadFileError, match=message):
        limited_to_recordings(config, system)


def test_runs_may_be_of_any_length_and_too_short_ones_are_left_out_and_named(
    tmp_path: Path, table: np.ndarray
):
    rows_per_run = 400
    keep = [slice(0, 400), slice(400, 408), slice(800, 1000), slice(1200, 1600)]
    lengths = [400, 8, 200, 400]
    cut = np.concatenate([table[rows] for rows in keep])
    assert len(table) > 4 * rows_per_run - 1
    write_csv(tmp_path / "lengths.csv", cut)
    toml, proposal = write_definition(str(tmp_path / "lengths.csv"))
    (told,) = [warning for warning in proposal.warnings if "left out" in warning]
    assert "1 of 4 runs are left out" in told
    assert "the 8 from line 402 on" in told
    system = load_system(*resolve(str(toml))[:2])
    assert isinstance(system, RecordedSystem)
    recordings = system.recordings
    assert recordings is not None
    assert list(recordings.rows) == lengths
    split = split_recordings(recordings, window_length(SUBSTEPS))
    assert {segment.run for segment in (*split.learning, *split.test)} == {0, 2, 3}
    data = read_transitions(dataset_from(system, tmp_path / "data"))
    assert rows_of(table, data.states.reshape(-1, 2)).min() >= 0


def test_short_recordings_get_a_shorter_super_step(tmp_path: Path):
    write_csv(tmp_path / "short.csv", recordings(runs=1, rows=150))
    write_csv(tmp_path / "long.csv", recordings(runs=1, rows=400))
    substeps = {}
    for name in ("short", "long"):
        _, proposal = write_definition(str(tmp_path / f"{name}.csv"))
        substeps[name] = proposal.definition.substeps
    assert 1 <= substeps["short"] < substeps["long"]


def as_written_elsewhere(text: str, delimiter: str, decimal: str) -> str:
    header, _, rows = text.partition("\n")
    header = header.replace("time s", "time [s]").replace("angle rad", "angle (rad)")
    rows = rows.replace(",", delimiter).replace(".", decimal)
    return f"# from a logger\n\n{header.replace(',', delimiter)}\n{rows}"


@pytest.mark.parametrize(
    ("delimiter", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", ",")], ids=repr
)
def test_semicolons_decimal_commas_and_units_in_brackets_say_the_same(
    folder: Path, tmp_path: Path, delimiter: str, decimal: str
):
    text = (folder / "runs.csv").read_text()
    (tmp_path / "runs.csv").write_text(as_written_elsewhere(text, delimiter, decimal))
    found = system_from(tmp_path / "runs.csv").recordings
    assert found is not None
    usual = read_recordings(recordings_from(folder / "runs.csv"))
    for states, expected in zip(read_recordings(found).states, usual.states, strict=True):
        np.testing.assert_array_equal(states, expected)


@pytest.mark.parametrize(
    ("scale", "offset", "message"),
    [
        (1e8, 0.0, "state.angle rad reaches"),
        (1e-8, 0.0, "taken for rounding. Give it in another unit"),
        (1.0, 1e4, "1 of 2400 samples lie more than 10 times as far out"),
    ],
)
def test_numbers_no_emulator_can_hold_and_samples_far_out_are_named(
    tmp_path: Path, table: np.ndarray, scale: float, offset: float, message: str
):
    odd = table.copy()
    odd[:, 2] *= scale
    odd[700, 2] += offset
    write_csv(tmp_path / "odd.csv", odd)
    try:
        _, proposal = write_definition(str(tmp_path / "odd.csv"))
        told = " ".join(proposal.warnings)
    except BadFileError as error:
        told = str(error)
    assert message in told
    assert "line 702" in told or not offset


class _Trap:
    def __reduce__(self) -> tuple:
        return os.mkdir, ("sprung",)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"states": np.zeros((3, 2))}, "states has shape (3, 2); wanted one row per time"),
        ({"state_names": ["angle rad"]}, "state_names lists 1 names for 2 columns"),
        ({"state_names": ["angle rad", "speed mph"]}, "state_names[1]: unknown unit 'mph'"),
        (
            {"controls": np.full((2400, 1), np.nan)},
            "controls, row 0, column 0: not a finite number",
        ),
        ({"run": np.array([_Trap()] * 2400)}, "Object arrays cannot be loaded"),
    ],
)
def test_a_bad_npz_is_refused_by_array(
    tmp_path: Path, table: np.ndarray, changes: dict, message: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    write_npz(tmp_path / "bad.npz", table, **changes)
    with pytest.raises(BadFileError) as caught:
        write_definition("bad.npz")
    assert message in str(caught.value)
    assert not (tmp_path / "sprung").exists()


def test_one_long_recording_is_cut_so_that_something_is_left_to_test_on(tmp_path: Path):
    write_csv(tmp_path / "one.csv", recordings(runs=1, rows=2400))
    learn, test = split_recordings(recordings_from(tmp_path / "one.csv"), window_length(SUBSTEPS))
    assert len(learn) > 10
    assert len(test) > 1
    segments = sorted([*learn, *test])
    for before, after in pairwise(segments):
        assert after.start - before.stop >= window_length(SUBSTEPS)
    assert min(segment.stop - segment.start for segment in test) >= 2400 // 20 - window_length(
        SUBSTEPS
    )


def test_a_toml_that_disagrees_with_its_recordings_is_refused(
    folder: Path, table: np.ndarray, tmp_path: Path
):
    write_csv(tmp_path / "runs.csv", table)
    system_from(tmp_path / "runs.csv")
    toml = tmp_path / "runs.toml"
    for old, new, message in (
        ("0.02", "0.01", "sampled every 0.02 s"),
        ("angle", "angel", "state columns are angle rad"),
    ):
        (tmp_path / "edited.toml").write_text(toml.read_text().replace(old, new))
        system = load_system(*resolve(str(tmp_path / "edited.toml"))[:2])
        with pytest.raises(NeuroAnimatorError, match=message):
            dataset_from(system, tmp_path / "data")


@pytest.fixture(scope="module")
def free_swing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a noisy swing of two coupled pendulums, which nothing drives, as swing.csv."""
    path = tmp_path_factory.mktemp("swing") / "swing.csv"
    rng = np.random.default_rng(0)
    angles = np.array([1.0, 0.2])
    speeds = np.zeros(2)
    lines = ["time s,state.a rad,state.b rad,state.da rad/s,state.db rad/s"]
    for k in range(3000):
        noisy = np.concatenate([angles, speeds]) + 0.002 * rng.normal(size=4)
        lines.append(",".join([f"{k * 0.02:.2f}", *(f"{number:.5f}" for number in noisy)]))
        for _ in range(20):
            pull = 4 * (angles[::-1] - angles)
            speeds = speeds + 0.001 * (pull - 16 * np.sin(angles) - 0.01 * speeds)
            angles = angles + 0.001 * speeds
    path.write_text("\n".join([*lines, ""]))
    return path.parent


@pytest.mark.endurance
def test_a_recording_that_nothing_drives_goes_all_the_way_without_an_edit(
    free_swing: Path, cli: Cli
):
    emulator = "swing.emulator.safetensors"
    for arguments in (
        ("new", "swing.csv"),
        ("generate", "swing.toml", "--out", "data"),
        (
            "train",
            "data",
            *small_training(500, "16,16", 128),
            "--out",
            emulator,
        ),
        ("animate", emulator, "--out", "clip.csv", "--out", "clip.glb"),
        ("evaluate", emulator, "--data", "data", "--report", "report.html"),
        ("info", emulator),
        ("export", emulator, "--out", "swing.h", "--out", "swing.onnx"),
    ):
        result = cli(*arguments, cwd=free_swing)
        assert result.returncode == 0, result.stderr
    assert "control" not in (free_swing / "swing.toml").read_text()
    clip = np.loadtxt(free_swing / "clip.csv", delimiter=",", skiprows=1)
    assert np.ptp(clip[:, 1]) > 0.5
    refused = cli("control", emulator, "--out", "found.csv", cwd=free_swing)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "nothing to control" in refused.stderr


def test_what_a_recording_kept_apart_is_trusted_where_it_is_like_the_rest(free_swing: Path):
    system = system_from(free_swing / "swing.csv")
    data = read_transitions(dataset_from(system, free_swing / "kept"))
    out = free_swing / "kept.emulator.safetensors"
    emulator = train(data, TrainingConfig(updates=500, widths=(16, 16), batch=128), out)
    assert data.held_out is not None
    states, controls = data.held_out
    assert np.mean(emulator.trust(states[:, :-1], controls) <= 1) > 0.9
    assert np.mean(emulator.trust(data.states[:, 0], data.controls[:, 0]) <= 1) > 0.95
    assert np.mean(emulator.trust(3 * states[:, :-1], controls) <= 1) < 0.5
    # Of one motion and of several, though their controls have no entries.
    for start, held in ((states[:, 0], controls), (states[0, 0], controls[0])):
        motion, scores = emulator.rollout_trusted(start, held)
        np.testing.assert_array_equal(motion, emulator.rollout(start, held))
        assert scores.shape == held.shape[:-1]


def test_an_npz_without_a_control_is_the_same_as_a_csv_without(free_swing: Path, tmp_path: Path):
    table = np.loadtxt(free_swing / "swing.csv", delimiter=",", skiprows=1)
    names = np.array(["a rad", "b rad", "da rad/s", "db rad/s"])
    np.savez(tmp_path / "swing.npz", time=table[:, 0], states=table[:, 1:], state_names=names)
    found = read_recordings(recordings_from(tmp_path / "swing.npz"))
    assert found.control == ()
    np.testing.assert_array_equal(found.states[0], table[:, 1:])
