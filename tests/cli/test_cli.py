"""Every verb works, every mistake gets one line and the right exit code."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pytest
from conftest import Cli
from waiting import PATIENCE

from neuroanimator.cli import doctor, info
from neuroanimator.cli.verbs import VERBS
from neuroanimator.control.synthesis.summary import gap_in_words
from neuroanimator.files.zoo import SHIPPED_SYSTEMS, shipped_policy

PROJECT = Path(__file__).parents[2] / "pyproject.toml"

MODULES = {"neuroanimator-studio": "neuroanimator_studio", "usd-core": "pxr"}
"""What packages are imported as, where that is not their name."""

RUN = "from neuroanimator.cli.main import main; main()"

TOLD = f"import jax; jax.config.update('jax_log_compiles', True); {RUN}"
"""JAX tells on stderr what it traces and compiles."""

TRACED = "Finished tracing"
"""Beginning of the line on a function that was traced."""


def test_help_names_every_verb_without_a_heavy_import():
    program = (
        "import sys; sys.argv = ['neuroanimator', '--help']\n"
        "from neuroanimator.cli.main import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        "print([name for name in ('jax', 'mujoco', 'matplotlib', 'scipy') if name in sys.modules])"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    lines = told.stdout.splitlines()
    assert lines[-1] == "[]", told.stderr
    assert [
        verb for verb in VERBS if not any(line.startswith(f"  {verb} ") for line in lines)
    ] == []


def test_list_makes_no_physics_and_loads_no_network():
    code = "import sys; from neuroanimator.cli import list; list.run(); print({'jax', 'mujoco'} & {*sys.modules})"
    listed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "bay_1" in listed.stdout, listed.stderr
    assert listed.stdout.splitlines()[-1] == "set()"


@pytest.mark.parametrize("verb", sorted(VERBS))
def test_each_verb_has_help_with_an_example(verb: str, cli: Cli):
    result = cli(verb, "--help")
    assert result.returncode == 0
    assert f"Example: neuroanimator {verb}" in " ".join(result.stdout.split())


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (
            ["generate", "pendlum", "--out", "d"],
            2,
            "No system called 'pendlum'. Did you mean pendulum? Systems: cape, cube, dolphin, fish, ",
        ),
        (["generate", "pendulum", "--out", "d", "--substeps", "0"], 2, "substeps: "),
        (["generate", "pendulum", "--out", "d", "--substeps", "7"], 2, "whole number"),
        (["generate", "pendulum", "--out", "d", "--count", "-5"], 2, "count: "),
        (
            ["generate", "pendulum", "--out", "d", "--threads", "-1"],
            2,
            "threads: wanted 1 or more, or 0 for all cores",
        ),
        (["train", "nowhere", "--out", "e.safetensors"], 3, "is not a dataset folder"),
        (["train", "nowhere", "--out", "e.safetensors", "--batch", "0"], 2, "batch: "),
        (["new", "missing.xml"], 3, "missing.xml"),
        (["evaluate", "--sweep", "pendulum", "--substeps", "x"], 2, "substeps: wanted numbers"),
        (["train", "nowhere", "--out", "e.safetensors", "--widths", "a,b"], 2, "widths: "),
        (
            ["train", "nowhere", "--out", "e.safetensors", "--config", "missing.toml"],
            3,
            "missing.toml",
        ),
        (["evaluate", "missing"], 3, "Shipped: cape-40, dolphin-100"),
        (["evaluate", "cube"], 3, "no emulator of cube ships"),
        (["info", "cube-50"], 3, "no emulator of cube ships"),
        (["export", "cube", "--out", "cube.h"], 3, "no emulator of cube ships"),
        (["animate", "cube", "--out", "clip.glb"], 3, "no emulator of cube ships"),
        (["control", "cube", "--goal", "up", "--out", "up.csv"], 3, "no emulator of cube ships"),
        (["policy", "pendulum", "--out", "p.policy.safetensors"], 2, "no [task]"),
        (["policy", "pendulum", "--minutes", "0", "--out", "p.policy.safetensors"], 2, "minutes"),
        (["policy", "none.toml", "--out", "p.policy.safetensors"], 3, "none.toml"),
        (["evaluate", "none.policy.safetensors"], 3, "none.policy.safetensors"),
        (
            ["animate", "pendulum", "--out", "clip.gif"],
            2,
            "ends in none of .csv, .glb, .mp4, .usda, .usdc, .usdz",
        ),
        (["animate", "pendulum", "--out", "clip.glb", "--rate", "nan"], 2, "rate: "),
        (["animate", "pendulum", "--out", "clip.glb", "--seconds", "-1"], 2, "seconds: "),
        (["animate", "pendulum", "--out", "clip.glb", "--seed", "-1"], 2, "seed: "),
        (["animate", "pendulum", "--out", "clip.glb", "--threshold", "2"], 2, "Give --hybrid"),
        (
            ["animate", "pendulum", "--out", "clip.glb", "--controls", "missing.csv"],
            3,
            "missing.csv",
        ),
        (["control", "pendulum", "--out", "c.csv", "--goal", "dance"], 2, "Goals: upright"),
        (
            ["control", "pendulum-passive", "--out", "c.csv"],
            2,
            "Goals of pendulum-passive: none. Write a file my.toml with the lines",
        ),
        (["export", "missing.csv", "--emulator", "pendulum", "--out", "c.glb"], 3, "missing.csv"),
        (["info", "missing"], 3, "No emulator file 'missing'"),
        (["dance"], 2, "No such command"),
        (
            ["anmate", "pendulum"],
            2,
            "Did you mean 'animate'? 'neuroanimator --help' lists the options.",
        ),
        (
            ["generate", "pendulum", "--count", "1e5", "--out", "d"],
            2,
            "'neuroanimator generate --help' lists",
        ),
        (["generate", "pendulum"], 2, "Missing option '--out'"),
        (["--verison"], 2, "--verison"),
    ],
)
def test_a_mistake_gets_one_line_and_its_exit_code(
    arguments, code: int, message: str, cli: Cli, tmp_path: Path
):
    result = cli(*arguments, cwd=tmp_path)
    assert result.returncode == code, result.stderr
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not [
        path for path in tmp_path.rglob("*") if path.suffix in (".glb", ".csv", ".safetensors")
    ]


def test_a_process_ends_with_the_line_and_the_code(cli_process: Cli):
    result = cli_process("info", "missing")
    assert (result.returncode, result.stdout) == (3, "")
    assert result.stderr.startswith("neuroanimator: No emulator file 'missing'")
    assert result.stderr.count("\n") == 1


def test_a_control_out_of_bounds_is_refused_by_name(cli: Cli, tmp_path: Path):
    path = tmp_path / "c.csv"
    path.write_text("time s,torque[0] N·m,torque[1] N·m,torque[2] N·m\n0,0,0,0\n0.05,0,99,0\n")
    result = cli("animate", "pendulum", "--controls", path, "--out", tmp_path / "c.glb")
    assert result.returncode == 2
    assert "torque[1] N·m out of bounds; wanted between -14 and 14, got 99" in result.stderr


def test_emulator_and_physics_take_turns_in_a_clip(cli: Cli, tmp_path: Path):
    drawn = ("animate", "pendulum", "--seconds", "1", "--out", tmp_path / "clip.csv")
    turns = cli(*drawn, "--hybrid", "--threshold", "0")
    assert turns.returncode == 0, turns.stderr
    assert "100% of the time by physics; error 0, of the emulator alone" in turns.stdout


def test_control_then_animate_then_export(cli: Cli, tmp_path: Path):
    controls, clip, scene = tmp_path / "c.csv", tmp_path / "clip.csv", tmp_path / "clip.glb"
    found = cli("control", "pendulum", "--seconds", "1.5", "--out", controls)
    assert found.returncode == 0, found.stderr
    assert "goal reached on the true physics  yes" in found.stdout
    assert cli("animate", "pendulum", "--controls", controls, "--out", clip).returncode == 0
    assert cli("export", clip, "--emulator", "pendulum", "--out", scene).returncode == 0
    assert scene.read_bytes()[:4] == b"glTF"


def test_info_and_list_and_doctor_answer(cli: Cli):
    info = json.loads(cli("info", "pendulum-50", "--json").stdout)
    assert (info["system"], info["substeps"], info["dt"]) == ("pendulum", 50, 0.05)
    listed = cli("list").stdout
    assert "pendulum-passive-100" in listed
    names = [line.split()[0] for line in listed.splitlines() if line.startswith("  ")]
    assert names[0] == "dolphin"
    assert names[len(SHIPPED_SYSTEMS) - 1] == "cube"  # nothing ships for it
    assert "swims by commands, speed and turn, through dolphin-50" in listed
    assert "swims by commands, speed and turn, through trout-32" in listed
    assert "video rendered by" in cli("doctor").stdout


def test_doctor_says_what_every_extra_is_for_and_whether_it_is_there(cli: Cli):
    project = tomllib.loads(PROJECT.read_text())["project"]
    assert {*doctor.EXTRAS} == {*project["optional-dependencies"]}
    rows = cli("doctor").stdout.splitlines()
    for extra, purpose in doctor.EXTRAS.items():
        (row,) = [row for row in rows if row.startswith(f"extra {extra} ")]
        assert purpose in row
        packages = [re.split(r"[\[>]", one)[0] for one in project["optional-dependencies"][extra]]
        is_there = all(find_spec(MODULES.get(name, name)) for name in packages)
        assert (" yes " in row) is is_there
        assert (f"pip install 'neuroanimator[{extra}]'" in row) is not is_there


def test_info_of_a_body_fits_on_a_screen_and_json_says_all(capsys):
    info.run("fish-50")
    shown = capsys.readouterr().out
    assert len(shown) < 1200
    assert "138 numbers" not in shown or "[m]" in shown
    info.run("fish-50", json=True)
    assert len(json.loads(capsys.readouterr().out)["state"]) > 0


def test_info_reads_policies_and_datasets(dataset: Path, capsys):
    info.run(str(shipped_policy("fish")))
    shown = capsys.readouterr().out
    assert "policy for" in shown
    assert "fish, n = 50" in shown
    info.run(str(dataset))
    shown = capsys.readouterr().out
    assert "6,000 asked for, seed 0" in shown
    assert "2 of 2 made" in shown


def test_the_version_is_told_without_heavy_imports(cli_process: Cli):
    result = cli_process("--version")
    assert (result.returncode, result.stdout) == (0, f"neuroanimator {version('neuroanimator')}\n")


def test_a_gap_is_told_in_words():
    assert "predicted a worse motion than the physics does" in gap_in_words(0.956, 0.315)
    assert "does what the emulator predicted" in gap_in_words(0.30, 0.31)
    assert "a little worse" in gap_in_words(0.3, 0.5)
    assert "much worse" in gap_in_words(0.3, 1.4)
    assert "lower is better" in gap_in_words(0.3, 1.4)


def test_of_a_missed_goal_nobody_says_that_the_physics_does_what_was_foretold():
    told = gap_in_words(3.0, 3.05, is_reached=False)
    assert told.endswith("the goal is missed: the emulator predicted as high a J")
    assert "the goal is missed: the physics does a little worse" in gap_in_words(0.3, 0.5, False)
    assert "missed" not in gap_in_words(0.3, 0.5, is_reached=True)


def test_a_motion_that_replays_repaired_is_no_better_prediction():
    told = gap_in_words(1143.0, 357.0, is_reached=True, is_corrected=True)
    assert "replays on the physics repaired the motion" in told
    assert "predicted" not in told


def written(words: tuple[str, ...], folder: Path, cache: Path) -> tuple[dict[str, bytes], bool]:
    """Return (the files that a command line leaves in `folder`, by name, whether JAX traced anything)."""
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "NEUROANIMATOR_BACKEND": "auto"}
    folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", TOLD, *words],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    return files, TRACED in done.stderr


def check_next_time(words: tuple[str, ...], folder: Path) -> None:
    """Run a command line with nothing kept, then again."""
    cache = folder / "cache"
    first, has_traced = written(words, folder / "first", cache)
    assert first
    assert has_traced
    assert written(words, folder / "next", cache) == (first, False)


def test_the_next_motion_is_not_traced(tmp_path: Path):
    check_next_time(("animate", "pendulum", "--out", "swing.glb"), tmp_path)


@pytest.mark.endurance
@pytest.mark.parametrize(
    "words",
    [
        ("animate", "fish", "--out", "fish.glb", "--out", "fish.csv"),
        ("control", "lander", "--goal", "pad", "--out", "landing.csv", "--glb", "landing.glb"),
    ],
    ids=" ".join,
)
def test_the_next_command_is_not_traced(words: tuple[str, ...], tmp_path: Path):
    check_next_time(words, tmp_path)
