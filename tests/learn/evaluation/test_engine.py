"""Under which gains a model was trained is in its emulator's file, and another release's are told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import Emulator, load_emulator, load_system
from neuroanimator.emulator.artifact import save
from neuroanimator.emulator.spec import GAINS, Engine
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.learn.evaluation.held_out import replayable_system, system_of
from neuroanimator.learn.training.initialise import spec_of
from neuroanimator.terminal import warn_once


def trained_under(emulator: Emulator, engine: Engine | None) -> Emulator:
    return replace(emulator, spec=replace(emulator.spec, engine=engine))


@pytest.fixture
def truck() -> Emulator:
    return load_emulator("truck-50")


def test_an_emulators_facts_have_the_gains_that_mujoco_compiled(truck: Emulator, tmp_path: Path):
    system = load_system("truck")
    engine = spec_of(system, 50, 0.1).engine
    assert engine is not None
    assert len(engine.gains) == len(GAINS) * system.control.size
    save(trained_under(truck, engine), tmp_path / "a.safetensors")
    assert load_emulator(tmp_path / "a.safetensors").spec.engine == engine


@pytest.mark.parametrize("place", range(3))
def test_gains_of_another_release_are_told_once_and_by_name(
    truck: Emulator, place: int, capsys: pytest.CaptureFixture[str]
):
    warn_once.cache_clear()
    engine = load_system("truck").engine
    assert engine is not None
    gains = np.array(engine.gains)
    system_of(trained_under(truck, Engine("3.14.0", tuple((gains * (1 + 1e-9)).tolist()))))
    assert not capsys.readouterr().err
    gains[place] = 2 * gains[place] + 1
    other = trained_under(truck, Engine("3.14.0", tuple(gains.tolist())))
    for load in (system_of, replayable_system):
        load(other)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert f"the {GAINS[place]} of the actuator '" in said[0]
    assert "by 3.14.0, under which the emulator was trained" in said[0]


@pytest.mark.parametrize(
    "engine",
    [
        {"release": 3, "gains": []},
        {"release": "3.17.0\n", "gains": []},
        {"release": "1", "gains": ["a"]},
        {"release": "1"},
    ],
)
def test_an_engine_that_is_none_is_refused(truck: Emulator, engine: object, tmp_path: Path):
    path = tmp_path / "a.safetensors"
    save(truck, path)
    tensors, metadata = read_tensors(path, "emulator")
    write_tensors(path, dict(tensors), metadata | {"engine": engine})
    with pytest.raises(Exception, match="is not a usable emulator"):
        load_emulator(path)
