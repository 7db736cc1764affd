"""A file may name a step function; only the user lets it run. A name out of a file is never a path."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest
from conftest import Cli
from forgery import BELL, forged_emulator, forged_policy

from neuroanimator import (
    DatasetConfig,
    Emulator,
    NeuroAnimatorError,
    evaluate,
    generate,
    load_system,
    read_diverged,
    read_transitions,
)
from neuroanimator.control.policies.policy import Policy
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.evaluation.held_out import replayable_system, system_of
from neuroanimator.physics import carried_system
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.physics.recorded.recording import read_recording
from neuroanimator.systems import trusted_files

STEP = """
STEP = 0.01
STATE = {"place": "m", "speed": "m/s"}
CONTROL = {"force": ("N", -1.0, 1.0)}
def step(state, control, dt):
    return [state[0] + dt * state[1], state[1] + dt * control[0]]
"""

TOML = """name = "trap"
kind = "python"
file = "trap.py"
physics = { step = 0.01, truth_step = 0.01, fine_step = 0.001 }
state = [{ name = "place", unit = "m" }, { name = "speed", unit = "m/s" }]
control = [{ name = "force", unit = "N", low = [-1.0], high = [1.0] }]
"""

RECORDED = TOML.replace('"python"', '"recorded"').replace("trap.py", "trap.csv").split("physics")[
    0
] + (
    'physics = { step = 0.01 }\nstate = [{ name = "place", unit = "m" }]\n'
    'control = [{ name = "force", unit = "N", low = [-1.0], high = [1.0] }]\n'
)


@pytest.fixture
def trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder, also the current one, with a step file that leaves a mark, and its TOML file; nothing is trusted."""
    monkeypatch.setattr(trusted_files, "_TRUSTED", {}, raising=False)
    folder = tmp_path / "folder"
    (folder / "inner").mkdir(parents=True)
    (folder / "trap.py").write_text(BELL.format(mark=str(folder / "mark")) + STEP)
    (folder / "trap.toml").write_text(TOML)
    monkeypatch.chdir(folder)
    yield folder
    assert not (folder / "mark").exists(), "a stranger's file ran Python code"


def paths_to(folder: Path) -> list[str]:
    """Return every way to say where the trap lies."""
    ways = [
        str(folder / "trap.toml"),
        "trap.toml",
        "./trap.toml",
        "inner/../trap.toml",
        "../folder/trap.toml",
    ]
    return [*ways, "trap", str(folder / "trap.py"), "file://" + str(folder / "trap.toml")]


def test_an_emulator_whose_system_is_a_path_runs_nothing(trap: Path):
    for way in paths_to(trap):
        with pytest.raises(NeuroAnimatorError):
            evaluate(
                Emulator.load(
                    forged_emulator(trap / "e.safetensors", lambda m, way=way: m.update(system=way))
                )
            )


def test_an_emulator_whose_system_is_a_path_finds_no_controller(trap: Path, shipped: Emulator):
    for way in paths_to(trap):
        spec = replace(shipped.spec, system=way)
        hostile = eqx.tree_at(lambda emulator: emulator.spec, shipped, spec)
        for use in (system_of, replayable_system, evaluate):
            with pytest.raises(NeuroAnimatorError):
                use(hostile)


def test_a_policy_whose_system_is_a_path_runs_nothing(trap: Path):
    for way in paths_to(trap)[:3]:
        with pytest.raises(BadFileError):
            Policy.load(
                forged_policy(
                    trap / "p.safetensors", lambda m, way=way: m["emulator"].update(system=way)
                )
            )


def test_a_dataset_whose_system_is_a_path_runs_nothing(trap: Path):
    generate(DatasetConfig(system="pendulum", count=12), trap / "data")
    path = trap / "data" / "dataset.json"
    sound = json.loads(path.read_text())
    for way in paths_to(trap):
        path.write_text(json.dumps(sound | {"system": way}))
        with pytest.raises(NeuroAnimatorError):
            read_transitions(trap / "data")
        with contextlib.suppress(NeuroAnimatorError):
            read_diverged(trap / "data")  # it needs no system


def test_a_configuration_whose_system_is_a_path_simulates_nothing(trap: Path):
    for way in paths_to(trap):
        hostile = DatasetConfig(system="pendulum", count=12).model_copy(update={"system": way})
        for use in (simulate_transitions, lambda config: generate(config, trap / "other")):
            with pytest.raises(NeuroAnimatorError):
                use(hostile)
        with pytest.raises(ArgumentError):
            DatasetConfig(system=way, count=12)


def test_the_command_line_runs_nothing_for_a_strangers_emulator(trap: Path, cli_process: Cli):
    path = forged_emulator(
        trap / "e.safetensors", lambda metadata: metadata.update(system=str(trap / "trap.toml"))
    )
    result = cli_process("evaluate", path)
    assert result.returncode == 3
    assert result.stderr.count("\n") == 1


def carried_text(folder: Path) -> str:
    """Return the definition that travels with emulators of the trap; reading it runs nothing."""
    return resolve(str(folder / "trap.toml"))[1]


def test_a_definition_that_travels_runs_only_where_the_user_says_so(trap: Path):
    system = carried_system("trap", carried_text(trap))
    start, controls = np.zeros((1, 2)), np.ones((1, 1, 1))
    with pytest.raises(
        BadFileError, match=r"made from trap\.py, .* only if you say so: .* --system PATH"
    ):
        system.simulate(start, controls, 0.01)
    assert not (trap / "mark").exists()
    trust_files("trap.toml")
    assert not (trap / "mark").exists()  # allowed is not run
    system.simulate(start, controls, 0.01)
    assert (trap / "mark").exists()
    os.unlink(trap / "mark")


def test_naming_ones_own_toml_file_in_python_is_saying_so(trap: Path):
    load_system("trap.toml").simulate(np.zeros((1, 2)), np.ones((1, 1, 1)), 0.01)
    assert (trap / "mark").exists()
    os.unlink(trap / "mark")


def test_what_changed_since_it_was_allowed_is_not_run(trap: Path):
    trust_files("trap.toml")
    (trap / "trap.py").write_text(BELL.format(mark=str(trap / "mark")) + "# another\n" + STEP)
    with pytest.raises(BadFileError, match="only if you say so"):
        carried_system("trap", carried_text(trap)).simulate(
            np.zeros((1, 2)), np.ones((1, 1, 1)), 0.01
        )


def test_a_lookup_allows_nothing(trap: Path):
    resolve("trap.toml")
    assert trusted_files._TRUSTED == {}


def test_a_definition_names_no_file_elsewhere(trap: Path):
    values = json.loads(carried_text(trap))
    for name in ("../trap.py", "/etc/passwd", "a\\b", "trap\n.py", "\x1b[31m", "", "..", 3, None):
        values["files"]["name"] = name
        with pytest.raises(NeuroAnimatorError) as caught:
            carried_system("trap", canonical_json(values))
        assert str(caught.value).isprintable()
    (trap / "trap.toml").write_text(TOML.replace('"trap.py"', '"../folder/trap.py"'))
    with pytest.raises(NeuroAnimatorError, match="a file beside it"):
        trust_files("trap.toml")


def test_a_definition_of_another_name_is_refused(trap: Path):
    with pytest.raises(BadFileError, match="of the system 'trap', not of 'pendulum'"):
        carried_system("pendulum", carried_text(trap))


def test_recordings_beside_a_strangers_emulator_are_not_opened(trap: Path):
    (trap / "trap.toml").write_text(RECORDED)
    rows = [f"{k / 100},{k},{k % 3}" for k in range(99)]
    (trap / "trap.csv").write_text(
        "\n".join(["time s,state.position m,control.force N", *rows, ""])
    )
    with pytest.raises(BadFileError, match=r"made from trap\.csv, .* only if you say so"):
        resolve("trap.toml")
    trust_files("trap.toml")
    text = resolve("trap.toml")[1]
    trusted_files._TRUSTED.clear(), read_recording.cache_clear()  # as in another process
    system = carried_system("trap", text)
    config = DatasetConfig(system=system.name, definition=system.definition_text)
    with pytest.raises(BadFileError, match="only if you say so"):
        simulate_transitions(config)


def test_a_toml_file_of_a_model_allows_nothing(trap: Path):
    (trap / "trap.xml").write_text(
        '<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>'
        '<actuator><motor joint="j" ctrlrange="-1 1"/></actuator></mujoco>'
    )
    (trap / "trap.toml").write_text(
        'name = "trap"\nmodel = "trap.xml"\nphysics = { step = 0.002, truth_step = 0.002, fine_step = 0.0002 }\n'
    )
    trust_files("trap.toml")
    assert trusted_files._TRUSTED == {}
