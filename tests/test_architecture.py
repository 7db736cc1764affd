"""The layout is what the documents say it is."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from collections import Counter
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "neuroanimator"
STUDIO = ROOT / "studio" / "neuroanimator_studio"
STAGES = [
    "errors", "text", "lazy", "terminal", "files", "codegen", "state", "appearance", "definitions", "emulator", "systems",
    "animation", "control", "export", "executor", "physics", "learn", "film", "gym", "scaffold", "authoring", "cli",
]  # fmt: skip


PUBLIC = {
    "neuroanimator",
    "neuroanimator.authoring",
    "neuroanimator.control",
    "neuroanimator.control.policies",
    "neuroanimator.learn.tasks",
}
"""Packages with public names: all of the core that the studio may use."""


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


def test_modules_import_each_other_one_way():
    """Imports inside functions and for type checkers are counted, too."""
    names = {}
    for path in SOURCE.rglob("*.py"):
        parts = path.relative_to(SOURCE.parent).with_suffix("").parts
        names[".".join(parts).removesuffix(".__init__")] = path
    imported = {}
    for own, path in names.items():
        imported[own] = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                for name in node.names:
                    module = f"{node.module}.{name.name}"
                    imported[own].add(module if module in names else node.module)
    assert list(TopologicalSorter(imported).static_order())


def test_the_core_knows_nothing_of_the_studio():
    for path in SOURCE.rglob("*.py"):
        assert "neuroanimator_studio" not in path.read_text(), path


def test_the_studio_uses_public_names_alone():
    """In the programs that it starts, too, of which one is the command line."""
    used = set()
    for path in STUDIO.rglob("*.py"):
        used |= set(re.findall(r"(?:from|import) (neuroanimator(?:\.\w+)*)\b", path.read_text()))
    assert used - {"neuroanimator.cli.main"} <= PUBLIC


def test_no_two_public_classes_have_the_same_name():
    names = Counter()
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                names[node.name] += 1
    assert {name for name, count in names.items() if count > 1} == set()


def test_temporary_folders_are_made_where_it_is_known_that_they_must_go():
    for path in [*SOURCE.rglob("*.py"), *STUDIO.rglob("*.py")]:
        assert not re.search("TemporaryDirectory|mkdtemp", path.read_text()), path


def test_one_module_says_how_child_processes_of_python_start():
    """With the present folder off their path: see `python_command`."""
    starting = [
        path
        for path in [*SOURCE.rglob("*.py"), *STUDIO.rglob("*.py")]
        if "sys.executable" in path.read_text()
    ]
    assert starting == [SOURCE / "executor" / "python_command.py"]


def test_the_architecture_names_what_exists_and_leaves_out_no_room():
    named = set(
        re.findall(
            r"`((?:src|studio|tests|benchmarks|examples|docs|\.ci)(?:/[\w./-]+)?)`",
            (ROOT / "ARCHITECTURE.md").read_text(),
        )
    )
    for name in named:
        assert (ROOT / name).exists(), name
    rooms = {stage if (SOURCE / stage).is_dir() else f"{stage}.py" for stage in STAGES}
    assert {f"src/neuroanimator/{room}" for room in rooms} <= named


def test_constraints_name_no_registry():
    for name in ("constraints.txt", "constraints-core.txt", "constraints-docs.txt"):
        text = (ROOT / name).read_text()
        assert "--hash=sha256:" in text
        assert "://" not in text
        assert "--index" not in text


def test_the_demo_runs_with_the_versions_that_are_tested():
    core, tested = (
        set(re.findall(r"^\S+==\S+", (ROOT / name).read_text(), re.MULTILINE))
        for name in ("constraints-core.txt", "constraints.txt")
    )
    assert core
    assert core < tested


IN_THE_ROOT = {
    ".ci", ".gitignore", "ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "Makefile", "README.md",
    "benchmarks", "blender", "constraints-core.txt", "constraints-docs.txt", "constraints.txt", "docs", "examples",
    "findings", "mkdocs.yml", "pyproject.toml", "src", "studio", "tests", "tools",
}  # fmt: skip
"""What may lie in the root of the repository; scratch files are no part of it."""


@pytest.mark.skipif(
    not (ROOT / ".git").exists() or shutil.which("git") is None, reason="no checkout of git"
)
def test_nothing_else_lies_in_the_root():
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True)
    assert {line.split("/")[0] for line in listed.stdout.decode().splitlines()} == IN_THE_ROOT
