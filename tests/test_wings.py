"""An emulator's file is a door: what plays an emulator needs nothing of what makes one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

SOURCE = Path(__file__).parents[1] / "src" / "neuroanimator"

MAKERS = (
    "executor",
    "physics",
    "learn",
    "film",
    "gym",
    "scaffold",
    "learn/finetune",
    "cli",
)
"""What makes emulators: physics, learning from it, films, learning of policies, and their verbs."""

PLAYERS_AMONG_THEM = (
    "film/options", "cli/main", "cli/verbs", "cli/formats", "cli/animate", "cli/control", "cli/export", "cli/list", "cli/doctor",
    "cli/motion_sources", "cli/shared_options",
)  # fmt: skip
"""The verbs of players."""

NEEDED_BY_MAKERS = (
    "mujoco", "optax", "matplotlib", "gymnasium", "imageio_ffmpeg", "jinja2", "tomlkit",
)  # fmt: skip

WITHOUT_THEM = """
import importlib.abc
import sys

class Missing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in {missing}:
            raise ModuleNotFoundError(f"No module named '{{name}}'", name=name)

sys.meta_path.insert(0, Missing())
"""

IMPORT = """
import importlib

for name in {names}:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        print(f"{{name}}: {{error}}")
"""

PLAY = """
import sys

from neuroanimator.cli.main import main

sys.argv = ["neuroanimator", "animate", "{name}", "--seconds", "0.5", "--out", "{name}.glb"]
main()
"""


def run_without_them(program: str, folder: Path) -> str:
    guarded = WITHOUT_THEM.format(missing=set(NEEDED_BY_MAKERS)) + program
    done = subprocess.run(
        [sys.executable, "-c", guarded],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def is_in(module: str, rooms: tuple[str, ...]) -> bool:
    return any(module == room or module.startswith(f"{room}/") for room in rooms)


def test_what_plays_an_emulator_imports_nothing_that_only_makers_need(tmp_path: Path):
    modules = [path.relative_to(SOURCE).with_suffix("").as_posix() for path in SOURCE.rglob("*.py")]
    playing = [
        module
        for module in modules
        if is_in(module, PLAYERS_AMONG_THEM) or not is_in(module, MAKERS)
    ]
    assert len(playing) > len(modules) / 3
    names = sorted(
        f"neuroanimator.{module.replace('/', '.')}".removesuffix(".__init__") for module in playing
    )
    assert run_without_them(IMPORT.format(names=names), tmp_path) == ""


@pytest.mark.parametrize("name", ["truck", "cape"])
def test_an_emulator_moves_where_its_physics_cannot(name: str, tmp_path: Path):
    run_without_them(PLAY.format(name=name), tmp_path)
    assert (tmp_path / f"{name}.glb").exists()
