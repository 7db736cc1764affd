"""What Python shows of the package: names to complete, a version, and one line for everything."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from swing_up import stand_upright

import neuroanimator as na
from neuroanimator import terminal
from neuroanimator.animation.clip import make_clip
from neuroanimator.control.policies.policy import load_policy
from neuroanimator.files.atomic import write_whole
from neuroanimator.files.zoo import find_policy


def test_completion_lists_the_public_names_and_loads_nothing():
    code = "import sys, neuroanimator as na; print(dir(na) == sorted([*na.__all__, '__version__']), 'jax' in sys.modules)"
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
        == "True False\n"
    )


def test_every_public_name_is_there():
    for name in dir(na):
        assert getattr(na, name) is not None


def test_the_version_is_that_of_the_installed_package():
    from importlib.metadata import version

    assert na.__version__ == version("neuroanimator")


def test_everything_a_user_holds_shows_itself_in_one_line(transitions):
    emulator = na.Emulator.load("pendulum-50")
    clip = make_clip(emulator, np.zeros((3, 6)))
    shown = {
        'Emulator("pendulum", 50 substeps, dt 0.05 s, 6 states, 3 controls, gated': emulator,
        'ModelSystem("lander", 13 states, 4 controls, step 2 ms, goals pad)': na.load_system(
            "lander"
        ),
        "Objective(Effort, ReachState)": stand_upright(),
        'Clip("pendulum", 4 frames, 0.10 s)': clip,
        'Transitions("pendulum", 6,000 windows, 50 substeps)': transitions,
        'Policy("fish", dt 0.1 s, 12 controls)': load_policy(find_policy("fish")),
    }
    for start, thing in shown.items():
        assert repr(thing).startswith(start)
        assert len(repr(thing)) < 120
        assert "\n" not in repr(thing)


@pytest.mark.parametrize("name", ["pendulum-50", "pendulum"])
def test_a_shipped_emulator_is_loaded_by_its_name(name: str):
    assert na.Emulator.load(name).substeps == 50


def test_an_unknown_name_lists_the_shipped_ones_and_a_path_is_never_a_name(tmp_path, monkeypatch):
    with pytest.raises(na.NeuroAnimatorError, match="Shipped: cape-40, dolphin-100"):
        na.Emulator.load("fish-51")
    for path in ("./fish-50", "fish-50.emulator.safetensors", tmp_path / "fish-50"):
        with pytest.raises(na.NeuroAnimatorError) as caught:
            na.Emulator.load(path)
        assert "Shipped" not in str(caught.value)


@pytest.mark.parametrize("is_command", [True, False])
def test_a_command_tells_of_a_folder_it_made_and_only_once(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    is_command: bool,
):
    monkeypatch.setattr(terminal._screen, "shows_phases", is_command)
    for name in ("a.csv", "b.csv"):
        write_whole(tmp_path / "new" / "er" / name, b"")
    told = capsys.readouterr().err.splitlines()
    folder = tmp_path / "new" / "er"
    assert told == [f"neuroanimator: The folder {folder} was not there: it was made."] * is_command
