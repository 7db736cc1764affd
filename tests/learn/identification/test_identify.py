"""Parameters come back from recordings, with honest deviations; what a recording does not tell is said by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli
from families import write_arm
from jaxtyping import Float

from neuroanimator import (
    DatasetConfig,
    Emulator,
    NeuroAnimatorError,
    Objective,
    TrainingConfig,
    effort,
    identify,
    load_emulator,
    load_system,
    reach_state,
    train,
)
from neuroanimator.control import EmulatorPlant, ParameterEstimator, Planner, control_plant
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.identification.measurements import Measurements, read_measurements
from neuroanimator.learn.identification.predictions import Predictor
from neuroanimator.learn.identification.unknowns import unknowns_of
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.systems.random_controls import sample_controls
from neuroanimator.systems.system import System

PARAMETERS = """
[parameters]
damping = { sets = "joint/shoulder/damping", range = [0.1, 0.4] }
mass = { sets = "body/upper/mass", range = [0.7, 1.4] }
gain = { sets = "actuator/elbow/gain", range = [0.6, 1.5] }
gear = { sets = "actuator/elbow/gear", range = [0.6, 1.5] }
"""
"""The last two only matter as a product."""

TRUE = {"damping": 0.3, "gain": 1.0, "gear": 1.2, "mass": 0.9}

STEPS = 100
"""Number of super steps in a recording: 4 s."""

WINDOW = 0.32
"""Length of windows [s], half the usual one: tests fit through two stages instead of three."""

Change = Callable[[Float[np.ndarray, "F S"]], Float[np.ndarray, "F S"]]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with arm.toml and a briefly trained emulator of its family."""
    folder = tmp_path_factory.mktemp("arm")
    toml = write_arm(folder, {}, PARAMETERS)
    trust_files(toml)
    name, definition, substeps = resolve(str(toml))
    config = DatasetConfig(
        system=name, definition=definition, substeps=substeps, count=20_016, samples_per_run=36
    )
    data = simulate_transitions(config)
    settings = TrainingConfig(updates=2000, widths=(48, 32))
    train(data, settings, folder / "arm.emulator.safetensors")
    return folder


@pytest.fixture(scope="module")
def emulator(arm: Path) -> Emulator:
    return load_emulator(arm / "arm.emulator.safetensors")


@pytest.fixture(scope="module")
def system(arm: Path) -> System:
    return load_system(str(arm / "arm.toml"))


def unchanged(states: Float[np.ndarray, "F S"]) -> Float[np.ndarray, "F S"]:
    return states


def record(
    path: Path,
    system: System,
    dt: float,
    *,
    seed: int = 0,
    has_velocities: bool = True,
    driven: tuple[float, float] = (1.0, 1.0),
    change: Change = unchanged,
    noise: float = 0.01,
    every: int = 1,
) -> Path:
    """Write what sensors record of the body `TRUE`, every so many parts of a super step; return the path."""
    rng = np.random.default_rng(seed)
    body = system.at(**TRUE)
    start = body.rest.copy()
    start[:2] = [1.2, -0.8]
    controls = sample_controls(rng, STEPS, dt, system.bounds) * np.array(driven)
    fine = np.repeat(controls, every, axis=0)
    runs = body.simulate(start[None], fine[None], dt / every)
    states = change(runs.states[0, :, :4])
    states = states + noise * states.std(axis=0) * rng.normal(size=states.shape)
    names = ["shoulder rad", "elbow rad", "shoulder.velocity rad/s", "elbow.velocity rad/s"]
    shown = 4 if has_velocities else 2
    columns = ["time s", *(f"state.{name}" for name in names[:shown])]
    header = ",".join([*columns, "control.shoulder N·m", "control.elbow N·m"])
    held = np.vstack([fine, fine[-1:]])
    times = dt / every * np.arange(len(states))
    table = np.column_stack([times, states[:, :shown], held])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g", encoding="utf-8")
    return path


@pytest.mark.parametrize(("has_velocities", "every"), [(True, 4), (False, 1)])
def test_parameters_come_back_within_their_deviations(
    has_velocities: bool, every: int, emulator: Emulator, system: System, tmp_path: Path
) -> None:
    paths = [
        record(
            tmp_path / f"{seed}.csv",
            system,
            emulator.dt,
            seed=seed,
            has_velocities=has_velocities,
            every=every,
        )
        for seed in range(2)
    ]
    found = identify(emulator, paths, window=WINDOW)
    assert found.proven is not None
    by_name = {estimate.name: estimate for estimate in found.estimates}
    for name in ("damping", "mass"):
        estimate = by_name[name]
        assert estimate.is_known
        error = abs(estimate.value - TRUE[name])
        assert error < 4 * estimate.deviation
        assert error < 0.05 * (estimate.high - estimate.low)
    # A hundredth of noise is left over, and less than with nominal parameters.
    for entry in found.measurements.entries:
        left = found.proven.residuals[..., entry].std()
        measured = np.nanstd(found.measurements.measured[..., entry])
        assert left < 0.03 * measured
        assert left < found.nominal.residuals[..., entry].std()


# Without noise, errors of slopes look like information.
@pytest.mark.parametrize("noise", [0.01, 0.0])
def test_what_cannot_be_told_apart_is_said_and_its_product_is_right(
    noise: float, emulator: Emulator, system: System, tmp_path: Path
) -> None:
    path = record(tmp_path / "r.csv", system, emulator.dt, noise=noise)
    found = identify(emulator, path, window=WINDOW)
    assert found.confused == (("gain", "gear"),)
    assert any("gain, gear: cannot be told apart" in note for note in found.notes)
    assert found.parameters["gain"] * found.parameters["gear"] == pytest.approx(1.2, rel=0.05)
    assert not any(e.is_known for e in found.estimates if e.name in ("gain", "gear"))


def test_what_a_recording_never_shows_stays_nominal_and_is_said(
    emulator: Emulator, system: System, tmp_path: Path
) -> None:
    # The elbow's motor does nothing in the recording.
    path = record(tmp_path / "r.csv", system, emulator.dt, driven=(1.0, 0.0))
    found = identify(emulator, path, window=WINDOW)
    for name in ("gain", "gear"):
        assert f"{name}: the recordings do not determine it" in "\n".join(found.notes)
        assert found.parameters[name] == pytest.approx(1.0, abs=0.05)


def test_an_offset_is_noticed_and_found(emulator: Emulator, system: System, tmp_path: Path) -> None:
    def shifted(states: Float[np.ndarray, "F S"]) -> Float[np.ndarray, "F S"]:
        return states + np.array([0.15, 0.0, 0.0, 0.0])

    path = record(tmp_path / "r.csv", system, emulator.dt, change=shifted)
    notes = identify(emulator, path, window=WINDOW, physics=False).notes
    assert any("shoulder[0] seems to be off" in note for note in notes)
    found = identify(emulator, path, offsets=True, window=WINDOW, physics=False)
    offsets = {e.name: e.value for e in found.estimates if e.name.startswith("offset")}
    assert offsets["offset of shoulder[0]"] == pytest.approx(0.15, abs=0.03)
    assert offsets["offset of elbow[0]"] == pytest.approx(0.0, abs=0.03)


def test_a_delay_is_noticed_and_found(emulator: Emulator, system: System, tmp_path: Path) -> None:
    every = 4
    late = emulator.dt / 2

    def delayed(states: Float[np.ndarray, "F S"]) -> Float[np.ndarray, "F S"]:
        return np.concatenate([states[:1], states[:1], states[:-2]])

    path = record(tmp_path / "r.csv", system, emulator.dt, change=delayed, every=every)
    notes = identify(emulator, path, window=WINDOW, physics=False).notes
    assert any("late" in note for note in notes)
    found = identify(emulator, path, delay=True, window=WINDOW, physics=False)
    delay = next(e for e in found.estimates if e.name == "delay")
    assert delay.value == pytest.approx(late, rel=0.15)
    assert "delay" not in found.parameters


def test_the_verb_prints_json_and_writes_a_report_and_an_emulator(
    arm: Path, system: System, emulator: Emulator, cli: Cli, tmp_path: Path
) -> None:
    path = record(tmp_path / "r.csv", system, emulator.dt)
    out = tmp_path / "mine.emulator.safetensors"
    report = tmp_path / "r.html"
    file = arm / "arm.emulator.safetensors"
    options = ["--from", path, "--system", arm / "arm.toml", "--window", WINDOW, "--json"]
    done = cli("identify", file, *options, "--out", out, "--report", report)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["is_proven"]
    assert set(found["parameters"]) == set(TRUE)
    mass = found["parameters"]["mass"]
    assert abs(mass["value"] - TRUE["mass"]) < 4 * mass["std"]
    mine = load_emulator(out)
    nominal = {p.name: p.nominal for p in mine.parameters}
    assert nominal["mass"] == pytest.approx(mass["value"], rel=1e-6)
    assert "<svg" in report.read_text()


def test_without_its_physics_nothing_is_proved_and_that_is_said(
    arm: Path, system: System, emulator: Emulator, cli_process: Cli, tmp_path: Path
) -> None:
    path = record(tmp_path / "r.csv", system, emulator.dt)
    alone = tmp_path / "alone.emulator.safetensors"
    alone.write_bytes((arm / "arm.emulator.safetensors").read_bytes())
    done = cli_process("identify", alone, "--from", path, "--window", WINDOW, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert not found["is_proven"]
    assert found["notes"][0].startswith("not verified: ")


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda text: text.replace("shoulder rad", "shoulder gon", 1), "unknown unit 'gon'"),
        (
            lambda text: text.replace("state.elbow rad,", "state.elbo rad,"),
            "Did you mean elbow rad",
        ),
        (lambda text: text.replace("state.elbow rad,", "state.elbow m,"), "is in m"),
        (lambda text: "\n".join(text.split("\n")[:4]) + "\n", "Record longer"),
        (lambda text: text.replace("\n0.4,", "\n0.41,"), "--resample"),
        (lambda text: text.replace("\n0.04,", "\n0.04,nan", 1), "finite number"),
        (lambda text: text.replace("control.elbow N·m", "control.elbow N"), "is in N,"),
    ],
)
def test_recordings_that_do_not_fit_are_refused_by_name(
    change: Callable[[str], str],
    wanted: str,
    emulator: Emulator,
    system: System,
    tmp_path: Path,
) -> None:
    path = record(tmp_path / "r.csv", system, emulator.dt)
    path.write_text(change(path.read_text()))
    with pytest.raises(NeuroAnimatorError) as error:
        identify(emulator, path)
    assert wanted in str(error.value)
    assert "r.csv" in str(error.value)


def test_plain_names_of_the_system_are_enough(
    emulator: Emulator, system: System, tmp_path: Path
) -> None:
    path = record(tmp_path / "r.csv", system, emulator.dt)
    rows = path.read_text().partition("\n")[2]
    plain = tmp_path / "plain.csv"
    names = "time,shoulder,elbow,shoulder.velocity,elbow.velocity,control.shoulder,control.elbow"
    plain.write_text(f"{names}\n{rows}")
    expected = read_measurements([path], emulator)
    found = read_measurements([plain], emulator)
    np.testing.assert_array_equal(found.measured, expected.measured)
    np.testing.assert_array_equal(found.controls, expected.controls)
    plain.write_text(f"{names.replace('control.elbow', 'elbow')}\n{rows}")
    with pytest.raises(
        NeuroAnimatorError, match="'elbow' may be 'state.elbow rad', 'control.elbow"
    ):
        read_measurements([plain], emulator)


def test_recordings_at_uneven_times_are_resampled_if_that_is_wanted(
    emulator: Emulator, system: System, tmp_path: Path
) -> None:
    path = record(tmp_path / "r.csv", system, emulator.dt, every=4, noise=0.0)
    expected = read_measurements([path], emulator)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:100], *lines[101:]]))
    with pytest.raises(NeuroAnimatorError, match="line 101, time: .*--resample"):
        read_measurements([path], emulator)
    found = read_measurements([path], emulator, resample=True)
    moving = slice(0, 4)
    np.testing.assert_allclose(
        found.measured[..., moving], expected.measured[..., moving], atol=0.02
    )


def test_noise_from_which_the_physics_diverges_is_refused(
    emulator: Emulator, system: System, tmp_path: Path
) -> None:
    path = record(tmp_path / "r.csv", system, emulator.dt, has_velocities=False, noise=1e8)
    with pytest.raises(NeuroAnimatorError, match=r"the physics diverges .* longer windows"):
        identify(emulator, path, window=WINDOW)


def test_degrees_called_radians_are_found(
    emulator: Emulator, system: System, tmp_path: Path
) -> None:
    def in_degrees(states: Float[np.ndarray, "F S"]) -> Float[np.ndarray, "F S"]:
        return states * np.array([57.3, 1.0, 1.0, 1.0])

    path = record(tmp_path / "r.csv", system, emulator.dt, change=in_degrees)
    with pytest.raises(NeuroAnimatorError, match=r"'shoulder rad' looks like degrees"):
        identify(emulator, path)


def test_an_emulator_of_one_body_has_nothing_to_be_found(shipped: Emulator, tmp_path: Path) -> None:
    with pytest.raises(NeuroAnimatorError, match="has no parameters"):
        identify(shipped, tmp_path / "r.csv")


def test_plans_know_the_body_after_a_while_if_its_parameters_are_estimated(
    emulator: Emulator, system: System
) -> None:
    """The emulator itself stands in for the body, so that nothing but parameters differs."""
    goal = reach_state(system, {"shoulder": [0.6], "elbow": [0.3]}, since=0.2)
    planner = Planner.of(emulator, Objective.of(effort(0.001), goal), 10)
    body = emulator.at(**TRUE).rest
    plant = EmulatorPlant(emulator)
    nominal = ParameterEstimator(emulator, every=1000)
    adapting = ParameterEstimator(emulator)
    misses = []
    for estimator in (nominal, adapting):
        motion = control_plant(planner, plant, body, 48, estimator=estimator)
        misses.append(np.abs(motion.states[-8:, :2] - [0.6, 0.3]).max())
    assert misses[1] < misses[0] / 2
    found = dict(zip([p.name for p in emulator.parameters], adapting.values, strict=True))
    assert found["mass"] == pytest.approx(TRUE["mass"], abs=0.02)
    assert found["damping"] == pytest.approx(TRUE["damping"], abs=0.02)
    product = found["gain"] * found["gear"]
    assert product == pytest.approx(TRUE["gain"] * TRUE["gear"], abs=0.03)


def test_slopes_from_measured_starts_equal_finite_differences(emulator: Emulator) -> None:
    rng = np.random.default_rng(1)
    starts = np.tile(emulator.rest, (3, 1))
    starts[:, :4] += rng.uniform(-0.5, 0.5, (3, 4))
    controls = rng.uniform(emulator.bounds.low, emulator.bounds.high, (3, 4, 2))
    states = np.repeat(starts[:, None], 5, axis=1)
    measurements = Measurements(states, controls, states, (), (0, 1, 2, 3), ())
    unknowns = unknowns_of(emulator, measurements)
    predictor = Predictor(emulator, measurements, unknowns, knows_starts=True)
    values = emulator.at(**TRUE).rest[list(emulator.parameter_entries)]
    found = predictor.slopes(starts, values).by_unknowns
    for place in range(len(values)):
        step = np.zeros(len(values))
        step[place] = 0.01
        later = predictor.slopes(starts, values + step).shown
        earlier = predictor.slopes(starts, values - step).shown
        np.testing.assert_allclose(found[..., place], (later - earlier) / 0.02, atol=5e-3)
    assert np.abs(found[:, 1:, :4]).max() > 0.1


def test_a_push_between_super_steps_says_nothing_of_parameters(emulator: Emulator) -> None:
    body = emulator.at(**TRUE).rest
    plant = EmulatorPlant(emulator)
    rng = np.random.default_rng(0)
    estimator = ParameterEstimator(emulator, windows=12)
    state = body.copy()
    for step in range(72):
        if step % 6 == 0:
            state[:4] += rng.uniform(-0.3, 0.3, 4)
        control = rng.uniform(emulator.bounds.low, emulator.bounds.high)
        following = plant(state, control)
        estimator.observe(state, control, following)
        state = following.copy()
    ranges = np.array([p.high - p.low for p in emulator.parameters])
    off = np.abs(estimator.values - body[list(emulator.parameter_entries)]) / ranges
    found = dict(zip([p.name for p in emulator.parameters], off, strict=True))
    assert found["mass"] < 0.05
    assert found["damping"] < 0.05
