"""An emulator's file names its system's model and carries none: the physics is asked of the user's own files."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from importlib import resources
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest
from conftest import Cli

from neuroanimator import (
    DatasetConfig,
    Emulator,
    evaluate,
    generate,
    load_emulator,
    load_system,
    make_clip,
    read_transitions,
    trust_files,
    write_glb,
)
from neuroanimator.definitions import carried
from neuroanimator.emulator.artifact import save
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.film.drawing import scene_of
from neuroanimator.film.options import Film, Take
from neuroanimator.film.rigid_scene import RigidScene
from neuroanimator.film.skeleton_scene import SkeletonScene
from neuroanimator.learn.data import shard_task
from neuroanimator.learn.data.shard_task import ShardTask, run_shard_task
from neuroanimator.learn.evaluation.held_out import replayable_system, system_of
from neuroanimator.physics.loading import resolve
from neuroanimator.systems import trusted_files
from neuroanimator.systems.model_files import read_model_files
from neuroanimator.systems.named_files import MissingPhysicsError
from neuroanimator.systems.trusted_files import trusted_so_far

ASSETS = resources.files("neuroanimator.systems") / "assets"


GOAL = """
[goals.turned]
seconds = 2.0
reach = { "root.heading" = [0.3] }
within = { "root.heading" = 0.2 }
"""


@pytest.fixture(autouse=True)
def _as_in_a_new_process(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(trusted_files, "_TRUSTED", {})
    monkeypatch.setattr(trusted_files, "_MODELS", [])
    monkeypatch.setattr(carried, "_FOLDERS", {})
    shard_task._system_of.cache_clear()


def forget():
    """Know nothing of what was read before, as another process."""
    trusted_files._MODELS.clear()
    carried._FOLDERS.clear()


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with somebody's own lander: `mine.toml`, its model, and an emulator made from them."""
    folder = tmp_path / "project"
    folder.mkdir()
    toml = (ASSETS / "lander.toml").read_text().replace('name = "lander"', 'name = "mine"')
    (folder / "mine.toml").write_text(toml + GOAL)
    (folder / "lander.xml").write_text((ASSETS / "lander.xml").read_text())
    name, text, _ = resolve(str(folder / "mine.toml"))
    _write_emulator(folder / "mine.emulator.safetensors", name, text)
    forget()
    return folder


def _write_emulator(path: Path, name: str, text: str) -> None:
    shipped = load_emulator("lander-50")
    spec = replace(shipped.spec, system=name, definition=text)
    save(eqx.tree_at(lambda emulator: emulator.spec, shipped, spec), path)


@pytest.fixture
def alone(project: Path, tmp_path: Path) -> Path:
    """The emulator's file alone in a folder."""
    folder = tmp_path / "alone"
    folder.mkdir()
    return Path(shutil.copy(project / "mine.emulator.safetensors", folder))


def test_the_file_holds_no_model(project: Path):
    content = (project / "mine.emulator.safetensors").read_bytes()
    for line in (project / "lander.xml").read_text().splitlines()[3:8]:
        assert line.strip().encode() not in content
    files = json.loads(Emulator.load(project / "mine.emulator.safetensors").definition)["files"]
    digests = read_model_files(project / "lander.xml").digests
    assert files == {"toml": "mine.toml", "main": "lander.xml", "sha256": digests}


def test_physics_is_found_beside_the_emulator_by_its_hash(project: Path):
    system = system_of(Emulator.load(project / "mine.emulator.safetensors"))
    start = system.rest[None]
    runs = system.simulate(start, np.zeros((1, 1, system.control.size)), 0.05)
    assert np.isfinite(runs.states).all()


def test_without_its_model_an_emulator_animates_and_one_line_says_what_is_wanted(alone: Path):
    emulator = Emulator.load(alone)
    states = emulator.rollout(np.array(emulator.spec.rest), np.zeros((4, emulator.control.size)))
    write_glb(make_clip(emulator, states), alone.with_name("a.glb"))
    for measure in (system_of, evaluate):
        with pytest.raises(MissingPhysicsError) as caught:
            measure(emulator)
        message = str(caught.value)
        assert "wanted mine.toml and its model beside it, or --system mine.toml" in message
        assert len(message.splitlines()) == 1
        assert caught.value.exit_code == 3


def test_a_goal_means_the_same_with_and_without_the_model(project: Path, alone: Path):
    there = system_of(Emulator.load(project / "mine.emulator.safetensors"))
    forget()
    absent = replayable_system(Emulator.load(alone))
    assert not absent.can_simulate
    # A goal at a site of the model needs the model.
    assert absent.goals == {"turned": there.goals["turned"]}


@pytest.mark.parametrize("changed", ["beside", "named"])
def test_a_model_that_differs_is_named_and_not_simulated(project: Path, alone: Path, changed: str):
    model = project / "lander.xml"
    model.write_text(model.read_text().replace("<worldbody>", "<worldbody> "))
    path = project / "mine.emulator.safetensors"
    if changed == "named":
        trust_files(project / "mine.toml")
        path = alone
    with pytest.raises(
        MissingPhysicsError, match=r"mine: 'lander.xml' is not what it was trained on"
    ):
        system_of(Emulator.load(path))


def test_a_toml_file_that_is_named_gives_the_physics(project: Path, alone: Path):
    trust_files(project / "mine.toml")
    assert system_of(Emulator.load(alone)).can_simulate


@pytest.mark.attack
def test_a_toml_file_nobody_named_reaches_no_other_folder(project: Path, alone: Path):
    """Both files may come from a stranger: only a TOML file that is named may name a path elsewhere."""
    toml = (project / "mine.toml").read_text()
    path = f'model = "{project / "lander.xml"}"'
    alone.with_name("mine.toml").write_text(toml.replace('model = "lander.xml"', path))
    with pytest.raises(MissingPhysicsError, match="was not found"):
        system_of(Emulator.load(alone))
    trust_files(alone.with_name("mine.toml"))
    assert system_of(Emulator.load(alone)).can_simulate


@pytest.mark.attack
def test_an_emulator_names_no_toml_file_in_another_folder(project: Path):
    text = Emulator.load(project / "mine.emulator.safetensors").definition
    for name in ("../mine.toml", str(project / "mine.toml"), "", "a\nb"):
        values = json.loads(text)
        values["files"]["toml"] = name
        with pytest.raises(BadFileError, match="damaged"):
            carried.read_definition_text(canonical_json(values))


def test_a_model_found_beside_an_emulator_lets_nobody_run_its_files(project: Path):
    """A stranger's model might list Python code among its files, for another emulator to name."""
    system_of(Emulator.load(project / "mine.emulator.safetensors"))
    assert trusted_so_far().models
    assert not trusted_so_far().files


def test_a_model_carried_by_an_older_file_is_still_simulated(project: Path, tmp_path: Path):
    values = json.loads(resolve(str(project / "mine.toml"))[1])
    values["files"] = read_model_files(project / "lander.xml").to_json()
    forget()
    old = tmp_path / "old.emulator.safetensors"
    _write_emulator(old, "mine", canonical_json(values))
    assert system_of(Emulator.load(old)).can_simulate


def test_a_dataset_holds_its_model_and_is_read_anywhere(project: Path, tmp_path: Path):
    system = load_system(str(project / "mine.toml"))
    config = DatasetConfig(system="mine", definition=system.definition_text, count=12)
    generate(config, tmp_path / "data")
    forget()
    shutil.rmtree(project)
    assert read_transitions(tmp_path / "data").system.can_simulate


def test_a_worker_gets_the_model_with_its_task(project: Path):
    system = load_system(str(project / "mine.toml"))
    config = DatasetConfig(system="mine", definition=system.definition_text, count=12)
    task = ShardTask(config, 0, 1, trusted_so_far())
    forget()
    with pytest.raises(MissingPhysicsError):
        run_shard_task(replace(task, trusted=trusted_so_far()))
    assert run_shard_task(task).shard is not None


@pytest.fixture
def take(project: Path) -> Take:
    emulator = Emulator.load(project / "mine.emulator.safetensors")
    states = emulator.rollout(np.array(emulator.spec.rest), np.zeros((2, emulator.control.size)))
    return Take((make_clip(emulator, states),))


def test_a_film_shows_the_model_or_where_it_is_not_the_bones(take: Take, project: Path):
    scene, _ = scene_of(take, Film())
    assert isinstance(scene, RigidScene)
    forget()
    shutil.rmtree(project)
    scene, _ = scene_of(take, Film())
    assert isinstance(scene, SkeletonScene)


def test_without_its_model_control_says_what_is_wanted_and_finds_what_nothing_proves(
    alone: Path, cli: Cli
):
    result = cli("control", alone, "--goal", "turned", "--out", "c.csv", cwd=alone.parent)
    assert result.returncode == 0, result.stderr
    assert "wanted mine.toml and its model beside it, or --system mine.toml" in result.stderr
    assert "not verified: this controller was tried on the emulator alone" in result.stdout
    assert (alone.parent / "c.csv").is_file()
