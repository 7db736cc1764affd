"""What identifies is given the same recordings, and figures of the tables are what they say."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from benchmarks.identification.emulators import FILES, SYSTEMS
from benchmarks.identification.identification import TOLERANCE, errors_of, settings_of, summary_rows
from benchmarks.identification.recordings import NOISE, record, write_recording
from benchmarks.identification.toolbox import OPTIMISERS, WAYS
from neuroanimator import load_system
from neuroanimator.physics.loading import trust_files
from neuroanimator.physics.recorded.recording import cut_runs, read_csv
from neuroanimator.systems.system import System

DT = 0.02


@pytest.fixture(scope="module")
def family() -> System:
    toml = FILES / "family.toml"
    trust_files(toml)
    return load_system(str(toml))


def test_every_emulator_is_of_what_it_says():
    for case in itertools.chain(*SYSTEMS.values()):
        reference = case.system
        if reference.endswith(".toml"):
            reference = str(FILES / reference)
        assert bool(load_system(reference).parameters) == (case.of == "family")


def test_a_recording_is_of_a_body_within_the_ranges_and_as_noisy_as_it_says(family: System):
    recording = record(family, DT, 1.0, seed=0)
    for value, parameter in zip(recording.true, family.parameters, strict=True):
        assert parameter.low <= value <= parameter.high
    start = family.rest.copy()
    start[family.parameter_entries] = recording.true
    start[:3] = [0.3, -0.2, 0.1]
    exact = family.simulate(start[None], recording.controls[None], DT).states[0]
    noise = recording.measured - exact[:, : family.parameter_entries.start]
    share = noise.std(axis=0) / recording.measured.std(axis=0)
    np.testing.assert_allclose(share, NOISE, rtol=0.4)


def test_a_written_recording_is_read_back_by_the_package(family: System, tmp_path: Path):
    recording = record(family, DT, 1.0, seed=1)
    path = tmp_path / "recording.csv"
    write_recording(path, recording, family)
    read = cut_runs(read_csv(path.read_bytes(), path.name), path.name)
    np.testing.assert_allclose(read.states[0], recording.measured, rtol=1e-6)
    np.testing.assert_allclose(read.controls[0][:-1], recording.controls, rtol=1e-6)


def test_errors_are_shares_of_ranges(family: System):
    recording = record(family, DT, 0.2, seed=2)
    ranges = np.array([parameter.high - parameter.low for parameter in family.parameters])
    off = recording.true + TOLERANCE * ranges
    np.testing.assert_allclose(errors_of(off, recording, family), TOLERANCE)


def test_every_way_is_tried_with_the_default_optimiser_and_all_steps():
    for way in WAYS:
        tried = settings_of(way)
        steps = {scheme for optimiser, scheme in tried if optimiser == "mujoco"}
        assert len(steps) == 3
        assert {optimiser for optimiser, _ in tried} <= set(OPTIMISERS)


def test_an_emulator_that_saves_no_time_never_pays_for_itself():
    def row(method: str, physics: str, seconds: float) -> dict[str, object]:
        return {
            "method": method,
            "seed": 0,
            "optimiser": "",
            "physics": physics,
            "is_found": True,
            "worst_error": 0.0,
            "mean_error": 0.0,
            "seconds": seconds,
            "cpu_seconds": seconds,
            "seconds_to_tolerance": seconds,
            "iterations": 10,
            "ms_an_iteration": seconds * 100,
        }

    rows = [
        row("ours, emulator alone", "", 1.0),
        row("ours", "rk4 2 ms", 2.0),
        row("slower", "", 12.0),
        row("sooner", "", 1.0),
    ]
    found = {line["method"]: line for line in summary_rows(rows, making_seconds=100.0)}
    assert found["slower"]["break_even_identifications"] == pytest.approx(10.0)
    assert found["sooner"]["break_even_identifications"] == np.inf
    assert found["slower"]["seconds_over_ours"] == pytest.approx(6.0)
