"""Recordings of the real world are read as they were made, and what is compared with them keeps the laws it should."""

from __future__ import annotations

import pickle
import struct
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks.real_recordings.cases import CASES, Case, windows
from benchmarks.real_recordings.cube_emulators import write_model
from benchmarks.real_recordings.cube_tosses import ORIENTATION, START_SAMPLES, flight_start
from benchmarks.real_recordings.errors import angle_errors, rotation_errors
from benchmarks.real_recordings.fitted_physics import model_at, parameters_of
from benchmarks.real_recordings.methods import FREE_METHODS
from benchmarks.real_recordings.physics import simulate
from benchmarks.real_recordings.runs import DT, Run, half_states, sampled_states, write_recording
from benchmarks.real_recordings.source_files import REPOSITORIES, check, source_files
from benchmarks.real_recordings.torch_file import MAGIC, read_tensor
from neuroanimator.physics.recorded.recording import cut_runs, read_csv

PENDULUMS = [case for case in CASES if not case.is_cube]
CUBE = next(case for case in CASES if case.is_cube)


def swings(case: Case, count: int = 3, samples: int = 300) -> list[Run]:
    """Runs of the case's own model, from random starts, under slow random controls."""
    rng = np.random.default_rng(0)
    starts = 0.3 * rng.normal(size=(count, len(case.columns.state)))
    if case.is_cube:
        starts[:, 2] += 1.0
        starts[:, ORIENTATION] = [1.0, 0.0, 0.0, 0.0]
    levels = 0.2 * rng.normal(size=(count, 1, len(case.columns.control)))
    controls = np.repeat(levels, samples, axis=1)
    states = simulate(case.model(), starts, controls[:, 1:], case.dt)
    halves = None if case.is_cube else states
    runs = []
    for number in range(count):
        pair = None if halves is None else np.stack([states[number], states[number]])
        runs.append(Run(str(number), states[number], controls[number], pair))
    return runs


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_written_recording_is_read_back_by_the_package(case: Case, tmp_path: Path):
    runs = swings(case)
    path = tmp_path / "recording.csv"
    write_recording(path, runs, case.columns, case.dt)
    recording = cut_runs(read_csv(path.read_bytes(), path.name), path.name)
    assert recording.state == case.columns.state
    assert recording.control == case.columns.control
    assert recording.step == pytest.approx(case.dt, rel=1e-4)
    for run, states, controls in zip(runs, recording.states, recording.controls, strict=True):
        np.testing.assert_allclose(states, run.states, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(controls, run.controls, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("case", PENDULUMS, ids=lambda case: case.name)
def test_an_authors_model_without_friction_keeps_its_energy(case: Case):
    model = case.model()
    model.dof_damping[:] = 0
    model.dof_frictionloss[:] = 0
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    start = np.ones((1, 2 * model.nq))
    ends = simulate(model, start, np.zeros((1, 400, 0)), case.dt)[0, [0, -1]]
    assert energy(model, ends[1]) == pytest.approx(energy(model, ends[0]), abs=1e-4)


def energy(model: mujoco.MjModel, state: np.ndarray) -> float:
    data = mujoco.MjData(model)
    data.qpos[:] = state[: model.nq]
    data.qvel[:] = state[model.nq :]
    mujoco.mj_forward(model, data)
    return float(data.energy.sum())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_every_method_begins_where_the_recording_does(case: Case):
    runs = swings(case)
    unseen = windows(case, runs)
    for _, method in FREE_METHODS.values():
        states = method(case, runs).predict(unseen.starts, unseen.controls)
        assert states.shape == unseen.states.shape
        np.testing.assert_array_equal(states[:, 0], unseen.starts)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_fitted_physics_begins_at_the_model(case: Case):
    parameters = parameters_of(case)
    shares = np.array([parameter.start for parameter in parameters])
    unseen = windows(case, swings(case))
    given = simulate(case.model_to_fit(), unseen.starts, unseen.controls, case.dt)
    ours = simulate(model_at(case, parameters, shares), unseen.starts, unseen.controls, case.dt)
    np.testing.assert_allclose(ours, given, atol=1e-6)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_every_fitted_parameter_changes_the_model(case: Case):
    for parameter in parameters_of(case):
        low, high = parameter.bounds
        models = [model_at(case, [parameter], np.array([share])) for share in (low, high)]
        numbers = [
            np.concatenate(
                [
                    model.body_mass,
                    model.body_inertia.ravel(),
                    model.body_ipos.ravel(),
                    model.body_pos.ravel(),
                    model.dof_damping,
                    model.dof_frictionloss,
                    model.actuator_gear.ravel(),
                    model.geom_friction.ravel(),
                    model.geom_solref.ravel(),
                    model.geom_size.ravel(),
                    model.geom_pos.ravel(),
                    model.opt.gravity,
                ]
            )
            for model in models
        ]
        assert not np.array_equal(*numbers), parameter.name


def test_a_toss_begins_with_the_state_whose_flight_its_first_samples_are():
    rng = np.random.default_rng(0)
    start = np.concatenate([[0, 0, 1], [1, 0, 0, 0], rng.normal(size=6)])
    flight = simulate(CUBE.model(), start[None], np.zeros((1, START_SAMPLES - 1, 0)), CUBE.dt)[0]
    measured = flight.copy()
    measured[:, 7:] = 0  # velocities as recorded play no part
    np.testing.assert_allclose(flight_start(measured), start, atol=0.02)  # a step's gravity is 0.07


def test_a_cube_is_written_with_its_fitted_numbers(tmp_path: Path):
    parameters = parameters_of(CUBE)
    shares = np.array([np.mean([parameter.start, *parameter.bounds]) for parameter in parameters])
    fitted = model_at(CUBE, parameters, shares)
    path = tmp_path / "cube.xml"
    write_model(CUBE, fitted, path)
    written = mujoco.MjModel.from_xml_path(str(path))
    unseen = windows(CUBE, swings(CUBE))
    given = simulate(fitted, unseen.starts, unseen.controls, CUBE.dt)
    ours = simulate(written, unseen.starts, unseen.controls, CUBE.dt)
    np.testing.assert_allclose(ours[:, :100], given[:, :100], atol=1e-4)


def test_velocities_are_the_slopes_of_what_was_recorded():
    time = np.arange(0, 2, 1e-3)
    angles = np.stack([np.sin(5 * time), np.cos(3 * time)], axis=1)
    states = sampled_states(time, angles, 0.03)
    kept = DT * np.arange(len(states))
    slopes = np.stack([5 * np.cos(5 * kept), -3 * np.sin(3 * kept)], axis=1)
    np.testing.assert_allclose(states[:, 2:], slopes, atol=1e-2)


def test_the_halves_tell_how_noisy_the_starts_are():
    rng = np.random.default_rng(0)
    time = np.arange(0, 40, 1e-3)
    angles = rng.normal(size=(len(time), 1))
    states = sampled_states(time, angles, 0.05)
    first, second = half_states(time, angles, 0.05)
    told = np.std((first - second) / 2, axis=0)
    # Interpolating every second sample smooths a little by itself.
    np.testing.assert_allclose(told, np.std(states[: len(first)], axis=0), rtol=0.3)


def test_angles_are_compared_within_a_turn_and_orientations_whatever_their_sign():
    recorded = np.zeros((1, 1, 4))
    turned = np.array([[[2 * np.pi, 0.1, 0, 0]]])
    np.testing.assert_allclose(angle_errors(recorded, turned), 0.1 / np.sqrt(2), atol=1e-12)
    pose = np.zeros((1, 1, 13))
    pose[..., ORIENTATION] = [1, 0, 0, 0]
    opposite = pose.copy()
    opposite[..., ORIENTATION] = [-np.cos(0.1), np.sin(0.1), 0, 0]
    np.testing.assert_allclose(rotation_errors(pose, opposite), 0.2, atol=1e-9)


def tensor_file(array: np.ndarray, made_by: bytes = b"torch._utils\n_rebuild_tensor_v2\n") -> bytes:
    """The bytes torch.save wrote before 1.6, put together by hand."""

    def number(value: int) -> bytes:
        return b"J" + struct.pack("<i", value)

    def shape(values: tuple[int, ...]) -> bytes:
        return b"(" + b"".join(number(value) for value in values) + b"t"

    strides = tuple(stride // array.itemsize for stride in array.strides)
    storage = (
        b"(X\x07\x00\x00\x00storagectorch\nDoubleStorage\nX\x01\x00\x00\x007X\x03\x00\x00\x00cpu"
        + number(array.size)
        + b"NtQ"
    )
    placed = number(0) + shape(array.shape) + shape(strides)
    thing = (
        b"\x80\x02c" + made_by + b"(" + storage + placed + b"\x89ccollections\nOrderedDict\n)RtR."
    )
    heads = [pickle.dumps(value, 2) for value in (MAGIC, 1001, {"little_endian": True})]
    keys = pickle.dumps(["7"], 2)
    count = array.size.to_bytes(8, "little")
    return b"".join([*heads, thing, keys, count, array.tobytes()])


def test_a_tensor_is_read_without_the_library_that_wrote_it():
    array = np.random.default_rng(0).normal(size=(1, 5, 19))
    np.testing.assert_array_equal(read_tensor(tensor_file(array)), array)


def test_a_tensor_file_that_calls_something_else_is_refused():
    with pytest.raises(ValueError, match=r"wanted one tensor"):
        read_tensor(tensor_file(np.ones((1, 2)), b"os\nsystem\n"))


def test_a_file_other_than_the_one_measured_is_refused():
    file = source_files(REPOSITORIES[0])[0]
    with pytest.raises(ValueError, match=r"sha256"):
        check(b"another", file)


def test_training_and_unseen_windows_may_not_begin_behind_the_end():
    case = PENDULUMS[0]
    runs = [replace(run, states=run.states[:150]) for run in swings(case)]
    with pytest.raises(ValueError, match=r"need at least one"):
        windows(case, runs)
