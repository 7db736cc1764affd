"""The layout is what the documents say it is."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "neuroanimator"
STAGES = [
    "lazy", "jax_later", "pytrees", "errors", "text", "parsing", "terminal", "machine", "cores",
    "zoo", "storage", "executor", "compiler", "codegen", "backend", "tables", "state", "appearance",
    "definitions", "emulator", "systems", "hybrid", "data", "training", "evaluation", "animation", "control",
    "improvement", "tasks",
    "export", "gym", "scaffold", "studio", "bench", "fleets", "demo", "cli",
]  # fmt: skip


def imported_stages(path: Path) -> set[str]:
    tree = ast.parse(path.read_text())
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {module.split(".")[1] for module in modules if module.startswith("neuroanimator.")}


def test_a_stage_imports_only_stages_above_it():
    for path in SOURCE.rglob("*.py"):
        stage = path.relative_to(SOURCE).parts[0].removesuffix(".py")
        if stage == "__init__":
            continue
        allowed = STAGES[: STAGES.index(stage) + 1]
        assert imported_stages(path) <= set(allowed), f"{path} imports downstream"


def test_everything_after_the_emulator_file_works_without_mujoco():
    for stage in (
        "animation",
        "appearance",
        "definitions",
        "emulator",
        "parsing",
        "state",
        "storage",
        "zoo",
    ):
        for path in [*SOURCE.glob(f"{stage}.py"), *SOURCE.glob(f"{stage}/*.py")]:
            assert "import mujoco" not in path.read_text()


def test_one_module_says_how_child_processes_of_python_start():
    """With the present folder off their path: see `python_command`."""
    starting = [path for path in SOURCE.rglob("*.py") if "sys.executable" in path.read_text()]
    assert starting == [SOURCE / "executor" / "python_command.py"]


def test_the_architecture_names_what_exists_and_leaves_out_no_room():
    named = set(
        re.findall(
            r"`((?:src|tests|benchmarks|examples|docs|\.ci)(?:/[\w./-]+)?)`",
            (ROOT / "ARCHITECTURE.md").read_text(),
        )
    )
    for name in named:
        assert (ROOT / name).exists(), name
    rooms = {stage if (SOURCE / stage).is_dir() else f"{stage}.py" for stage in STAGES}
    assert {f"src/neuroanimator/{room}" for room in rooms} <= named


def test_constraints_name_no_registry():
    for name in ("constraints.txt", "constraints-docs.txt"):
        text = (ROOT / name).read_text()
        assert "--hash=sha256:" in text
        assert "://" not in text
        assert "--index" not in text
