"""A run whose physics diverges is dropped, counted, and saved so that it can be replayed."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli

from neuroanimator import (
    DatasetConfig,
    NeuroAnimatorError,
    coverage,
    generate,
    load_system,
    read_diverged,
    read_transitions,
)
from neuroanimator.learn.data.store import read_config
from neuroanimator.physics.loading import resolve

JELLY = """\
name = "jelly"
kind = "mass-spring"
substeps = 10

[physics]
step = 0.01
truth_step = 0.01
truth_integrator = "symplectic"  # stable for small vibrations, not for a squeeze like these muscles'
fine_step = 0.001

[nodes]
nose = [0.2, 0.0, 0.0, 0.1]
left = [0.0, 0.1, 0.0, 0.1]
right = [0.0, -0.1, 0.0, 0.1]
top = [0.0, 0.0, 0.1, 0.1]

[springs.all]
stiffness = 500.0
damping = 0.05
pairs = [["nose", "left"], ["nose", "right"], ["nose", "top"], ["left", "right"], ["left", "top"], ["right", "top"]]

[muscles]
shorten = 0.85

[muscles.springs]
pull = [["nose", "left"], ["nose", "right"], ["nose", "top"], ["left", "right"], ["left", "top"], ["right", "top"]]

[water]
face_drag = 0.0

[sampling]
rest_share = 0.0
velocity = [1.0, 1.0, 1.0]
"""


def fingerprint(folder: Path) -> dict[str, str]:
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.glob("*.*s*"))
    }


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("jelly") / "jelly.toml"
    path.write_text(JELLY)
    return path


@pytest.fixture(scope="module")
def folder(toml: Path, cli_process: Cli) -> Path:
    words = ("--count", 6000, "--samples-per-run", 12, "--out", toml.parent / "data")
    made = cli_process("generate", toml, *words)
    assert made.returncode == 0, made.stderr
    dropped = len(read_diverged(toml.parent / "data")[0])
    said = " ".join(made.stdout.split())
    assert f"runs diverged and dropped {dropped}" in said
    assert "diverged-*.safetensors" in said
    return toml.parent / "data"


def test_a_body_that_diverges_is_dropped_counted_and_diverges_again_when_replayed(folder: Path):
    transitions, (starts, controls) = read_transitions(folder), read_diverged(folder)
    system = transitions.system
    assert 0 < len(starts) == transitions.diverged < 500
    assert starts.dtype == controls.dtype == np.float64
    assert len(transitions.states) == (500 - len(starts)) * 12
    assert system.simulate(starts, controls, 0.1).has_diverged.all()
    assert not system.simulate(starts, controls, 0.1, scheme=system.fine).has_diverged.all()


def test_diverged_runs_are_counted_and_told_with_what_to_do(folder: Path, cli: Cli):
    starts, _ = read_diverged(folder)
    found = coverage(folder)
    assert found.diverged.runs == len(starts)
    assert found.diverged.share == pytest.approx(len(starts) / 500)
    assert found.runs == 500 - len(starts)
    assert found.transitions == found.runs * 12
    assert any("controls, rms share" in condition for condition in found.diverged.conditions)
    shown = cli("info", folder).stdout
    assert f"{len(starts)} runs, dropped" in shown
    assert "take a shorter truth_step" in shown


def test_made_again_and_resumed_the_bytes_are_the_same(folder: Path, toml: Path, tmp_path: Path):
    before = fingerprint(folder)
    assert sum(name.startswith("diverged") for name in before) == 2
    for lost in ("shard-00000.safetensors", "diverged-00001.safetensors"):
        (folder / lost).unlink()
    name, definition, substeps = resolve(str(toml))
    config = DatasetConfig(system=name, definition=definition, substeps=substeps, count=6000)
    assert generate(config, folder, threads=1) == len(read_diverged(folder)[0])
    assert fingerprint(folder) == before


def test_a_damaged_file_is_refused_when_read_and_other_runs_are_not_overwritten(
    folder: Path, tmp_path: Path
):
    for path in folder.glob("*.*s*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    first, second = (tmp_path / f"diverged-0000{i}.safetensors" for i in range(2))
    first.write_bytes(second.read_bytes())
    with pytest.raises(NeuroAnimatorError, match="diverged-00000.* belongs to another dataset"):
        read_diverged(tmp_path)
    config = read_config(tmp_path)
    with pytest.raises(
        NeuroAnimatorError, match="diverged-00000.* holds runs of another dataset.* Move it away"
    ):
        generate(config, tmp_path)
    assert first.read_bytes() == second.read_bytes()
    first.write_bytes(first.read_bytes()[:-8])
    with pytest.raises(NeuroAnimatorError, match="diverged-00000.* is not a usable diverged file"):
        read_diverged(tmp_path)
    generate(config, tmp_path)
    assert fingerprint(tmp_path) == fingerprint(folder)


def test_a_dataset_without_diverged_runs_has_none_to_replay(dataset: Path):
    assert len(read_diverged(dataset)[0]) == 0
    assert not list(dataset.glob("diverged*"))
    assert load_system("pendulum").name == "pendulum"
