"""Two seconds of real pendulums and two real tosses are read as a user's files are, and predicted and identified by physics."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from jaxtyping import Float

from benchmarks.real_recordings.cases import CASES, MODELS, Case, Windows, windows
from benchmarks.real_recordings.cube_tosses import ORIENTATION
from benchmarks.real_recordings.errors import angle_errors, position_errors, rotation_errors
from benchmarks.real_recordings.excerpts import EXCERPTS
from benchmarks.real_recordings.methods import FREE_METHODS
from benchmarks.real_recordings.physics import simulate
from benchmarks.real_recordings.runs import Columns, Run, write_recording
from neuroanimator import (
    DatasetConfig,
    Emulator,
    NeuroAnimatorError,
    TrainingConfig,
    identify,
    train,
)
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.identification.measurements import read_measurements
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.physics.recorded.recording import Recording, cut_runs, read_csv
from neuroanimator.scaffold.write_toml import write_definition

FOLDER = Path(__file__).parent / "recordings"

TRIPLE, PENDUBOT, CUBE = (next(case for case in CASES if case.name == name) for name in EXCERPTS)

LEARNT = 280
"""Number of samples of the triple pendulum that it is identified from: 1.4 s; the rest is unseen."""

DAMPINGS = (0.01, 0.003, 0.001)
"""Largest damping of each hinge of the family [N·m·s/rad]; the authors found 0.0015, 0.00026 and 0.00001."""


def read_excerpt(case: Case) -> Recording:
    path = FOLDER / EXCERPTS[case.name]
    return cut_runs(read_csv(path.read_bytes(), path.name), path.name)


def runs_of(case: Case) -> list[Run]:
    recording = read_excerpt(case)
    runs = zip(recording.states, recording.controls, strict=True)
    return [Run(str(number), states, controls) for number, (states, controls) in enumerate(runs)]


def errors_of(case: Case, unseen: Windows, states: Float[np.ndarray, "W T S"]) -> np.ndarray:
    """Mean angle errors [rad] of pendulums a quarter of a second ahead, of cubes position and rotation in a toss."""
    if case.is_cube:
        moved = np.nanmean(position_errors(unseen.states, states))
        turned = np.nanmean(rotation_errors(unseen.states, states))
        return np.array([moved, turned])
    return np.array([angle_errors(unseen.states, states)[:, round(0.25 / case.dt)].mean()])


@pytest.mark.parametrize("case", [TRIPLE, PENDUBOT, CUBE], ids=lambda case: case.name)
def test_an_excerpt_has_the_columns_units_and_interval_of_its_case(case: Case):
    recording = read_excerpt(case)
    assert recording.state == case.columns.state
    assert recording.control == case.columns.control
    assert recording.step == pytest.approx(case.dt, rel=1e-4)
    for states in recording.states:
        if case.is_cube:
            lengths = np.linalg.norm(states[:, ORIENTATION], axis=1)
            np.testing.assert_allclose(lengths, 1, atol=1e-3)
            continue
        hinges = states.shape[1] // 2
        slopes = np.gradient(states[:, :hinges], recording.step, axis=0)[1:-1]
        off = slopes - states[1:-1, hinges:]
        assert np.sqrt(np.mean(off**2)) < 0.1 * states[:, hinges:].std()


@pytest.mark.parametrize(
    ("case", "bounds"),
    [(TRIPLE, [0.005]), (PENDUBOT, [0.1]), (CUBE, [0.02, 0.3])],
    ids=["triple", "pendubot", "cube"],
)
def test_physics_with_the_authors_parameters_predicts_what_baselines_do_not(
    case: Case, bounds: list[float]
):
    runs = runs_of(case)
    unseen = windows(case, runs)
    errors = {}
    for name, (_, method) in FREE_METHODS.items():
        states = method(case, runs).predict(unseen.starts, unseen.controls)
        errors[name] = errors_of(case, unseen, states)
    physics = errors["physics, authors' parameters"]
    assert (physics < bounds).all()
    assert (2 * physics < errors["persistence"]).all()
    assert (2 * physics < errors["constant velocity"]).all()


def write_angles(path: Path, angles: Float[np.ndarray, "T Q"]) -> Path:
    run = Run("swing", angles, np.zeros((len(angles), 0)))
    write_recording(path, [run], Columns(TRIPLE.columns.state[:3], ()), TRIPLE.dt)
    return path


SETTINGS = TrainingConfig(updates=1000, widths=(32, 24), batch=256)


@pytest.fixture(scope="module")
def triple_pendulums(tmp_path_factory: pytest.TempPathFactory) -> Transitions:
    """Transitions of triple pendulums of any damping, which move like the recorded one."""
    folder = tmp_path_factory.mktemp("triple")
    shutil.copy(MODELS / TRIPLE.model_file, folder)
    toml, _ = write_definition(str(folder / TRIPLE.model_file))
    document = tomlkit.parse(toml.read_text(encoding="utf-8"))
    document["substeps"] = 20
    fastest = np.abs(runs_of(TRIPLE)[0].states).max(axis=0)
    parameters = {}
    for number, damping in enumerate(DAMPINGS):
        hinge = f"hinge{number + 1}"
        document["sampling"]["position"][hinge] = float(fastest[number])
        document["sampling"]["velocity"][hinge] = [float(fastest[number + 3]) / 2]
        parameters[f"damping{number + 1}"] = {
            "sets": f"joint/{hinge}/damping",
            "range": [0.0, damping],
        }
    document["parameters"] = parameters
    toml.write_text(tomlkit.dumps(document), encoding="utf-8")
    trust_files(toml)
    name, definition, substeps = resolve(str(toml))
    config = DatasetConfig(
        system=name, definition=definition, substeps=substeps, count=9_000, samples_per_run=36
    )
    return simulate_transitions(config)


@pytest.fixture(scope="module")
def emulator(triple_pendulums: Transitions) -> Emulator:
    """An emulator of them that has not been trained, to read recordings for."""
    return build_emulator(triple_pendulums, SETTINGS)


@pytest.mark.endurance  # tests/learn/identification finds parameters in simulated recordings
def test_dampings_found_in_angles_predict_unseen_motion_as_the_authors_do(
    triple_pendulums: Transitions, tmp_path: Path
):
    emulator = train(triple_pendulums, SETTINGS, tmp_path / "triple.emulator.safetensors")
    [swing] = runs_of(TRIPLE)
    path = write_angles(tmp_path / "angles.csv", swing.states[:LEARNT, :3])
    found = identify(emulator, path, window=0.4)
    unseen = windows(TRIPLE, [replace(swing, states=swing.states[LEARNT - 120 :])])

    def error_at(dampings: list[float]) -> float:
        model = TRIPLE.model()
        model.dof_damping[:] = dampings
        states = simulate(model, unseen.starts, unseen.controls, TRIPLE.dt)
        return float(errors_of(TRIPLE, unseen, states)[0])

    authors = error_at(TRIPLE.model().dof_damping.tolist())
    assert error_at(list(found.parameters.values())) < 1.3 * authors
    assert error_at(list(DAMPINGS)) > 2 * authors


def test_angles_within_half_a_turn_are_unwrapped(emulator: Emulator, tmp_path: Path):
    turned = runs_of(TRIPLE)[0].states[:, :3] + np.pi
    wrapped = (turned + np.pi) % (2 * np.pi) - np.pi
    assert np.ptp(wrapped, axis=0).min() > 6  # each crosses the border
    plain = read_measurements([write_angles(tmp_path / "plain.csv", turned)], emulator)
    cut = read_measurements([write_angles(tmp_path / "wrapped.csv", wrapped)], emulator)
    turns = (plain.measured - cut.measured)[..., :3] / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-5)
    assert np.ptp(turns.reshape(-1, 3).round(), axis=0).max() == 0
    np.testing.assert_allclose(plain.guess[..., 3:6], cut.guess[..., 3:6], atol=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (r"state.hinge1 rad", "state.hinge1 deg", "deg"),
        (r"state.hinge3 rad", "state.finger rad", "no column of the emulator"),
    ],
)
def test_other_units_and_names_are_refused_by_column(
    old: str, new: str, told: str, emulator: Emulator, tmp_path: Path
):
    text = (FOLDER / EXCERPTS[TRIPLE.name]).read_text(encoding="utf-8")
    path = tmp_path / "swing.csv"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(NeuroAnimatorError, match=told):
        read_measurements([path], emulator)


def test_degrees_that_are_called_radians_are_refused(emulator: Emulator, tmp_path: Path):
    [swing] = runs_of(TRIPLE)
    states = swing.states * [180 / np.pi, 180 / np.pi, 180 / np.pi, 1, 1, 1]
    path = tmp_path / "swing.csv"
    write_recording(path, [replace(swing, states=states)], TRIPLE.columns, TRIPLE.dt)
    with pytest.raises(NeuroAnimatorError, match="looks like degrees"):
        read_measurements([path], emulator)


def test_a_lost_sample_is_refused_by_line(tmp_path: Path):
    lines = (FOLDER / EXCERPTS[PENDUBOT.name]).read_text(encoding="utf-8").splitlines()
    del lines[200]
    with pytest.raises(NeuroAnimatorError, match="line 201"):
        cut_runs(read_csv("\n".join(lines).encode(), "swing-up.csv"), "swing-up.csv")
