"""The public names: what examples and tutorials use, each importable and documented, none from inside."""

from __future__ import annotations

import importlib
import inspect
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import neuroanimator as na

ROOT = Path(__file__).parent.parent
PUBLIC = (
    "neuroanimator",
    "neuroanimator.control",
    "neuroanimator.control.policies",
    "neuroanimator.learn.tasks",
)
"""Packages with names for users, besides `neuroanimator.gym`, which needs an extra."""

IMPORT = re.compile(r"^\s*(?:from|import) +(neuroanimator[\w.]*)", re.MULTILINE)
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)


def code_of(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return text
    return "\n".join(BLOCK.findall(text))


SHOWN = [
    *ROOT.glob("examples/*.py"),
    *ROOT.glob("docs/*.md"),
    *ROOT.glob("docs/tutorials/*.md"),
    ROOT / "README.md",
]
SHOWN.remove(
    ROOT / "docs" / "extending.md"
)  # it shows developers the inner classes that they extend


@pytest.mark.parametrize("path", sorted(SHOWN), ids=lambda path: path.name)
def test_nobody_needs_an_inner_module(path: Path):
    modules = set(IMPORT.findall(code_of(path)))
    assert modules <= {*PUBLIC, "neuroanimator.gym"}


OBJECT = re.compile(r"\b(Emulator|System|Objective|Policy|Clip|Replay|Synthesis|Dataset)\b")
"""A class of objects that are loaded or made, in an annotation."""


@pytest.mark.parametrize("package", PUBLIC)
def test_what_is_no_object_of_the_wanted_kind_is_refused_at_once_in_one_line(package: str):
    """Whichever public function is given it, and whatever else that needs."""
    module = importlib.import_module(package)
    tried = 0
    for name in module.__all__:
        function = getattr(module, name)
        if not inspect.isfunction(function):
            continue
        for parameter, annotation in inspect.get_annotations(function).items():
            if parameter == "return" or not OBJECT.search(annotation) or "[[" in annotation:
                continue
            for wrong in (object(), 3.5, "no such thing"):
                if isinstance(wrong, str) and re.search(r"\bstr\b", annotation):
                    continue
                with pytest.raises(na.NeuroAnimatorError) as refusal:
                    function(**{parameter: wrong})
                assert "\n" not in str(refusal.value), (name, parameter)
                tried += 1
    assert tried or package == "neuroanimator.learn.tasks"


def test_a_name_does_where_an_object_is_wanted_and_a_cost_where_an_objective_is():
    emulator = na.load_emulator("pendulum")
    system = na.load_system("pendulum")
    goal: Any = na.goal(cast(Any, "pendulum"), "upright")
    controls = np.zeros((3, 3))
    by_name = na.replay(cast(Any, "pendulum"), cast(Any, "pendulum"), goal, system.rest, controls)
    by_object = na.replay(emulator, system, na.Objective.of(goal), system.rest, controls)
    assert by_name.cost_physics == by_object.cost_physics
    costs: Any = [goal, na.effort()]
    assert na.replay(emulator, system, costs, system.rest, controls).cost_physics > 0


@pytest.mark.parametrize(
    ("wanted", "call"),
    [
        ("objective: wanted Objective, as Objective.of returns, got the text 'upright'.",
         lambda given: na.descend(given, cast(Any, "upright"), [0.0], steps=1)),
        ("clips: wanted Clip, as make_clip returns, got the text 'swim.csv'.",
         lambda given: na.write_glb(cast(Any, "swim.csv"), "swim.glb")),
        ("system: wanted System, as load_system returns, got Emulator.",
         lambda given: na.goal(given, "upright")),
    ],
)  # fmt: skip
def test_a_refusal_names_what_makes_the_object(wanted: str, call: Callable[[Any], object]):
    with pytest.raises(na.NeuroAnimatorError, match=re.escape(wanted)):
        call(na.load_emulator("pendulum"))


def test_public_functions_are_the_same_in_other_processes():
    assert pickle.loads(pickle.dumps(na.evaluate)) is na.evaluate


@pytest.mark.parametrize("package", [*PUBLIC, "neuroanimator.authoring"])
def test_every_public_name_is_there_and_documented(package: str):
    module = importlib.import_module(package)
    assert module.__doc__
    assert len(set(module.__all__)) == len(module.__all__)
    for name in module.__all__:
        thing = getattr(module, name)
        assert name in dir(module)
        if callable(thing):
            assert thing.__doc__, name


def test_an_objective_within_an_objective_is_refused():
    inner = na.Objective.of(na.effort(0.1))
    with pytest.raises(na.NeuroAnimatorError, match=r"got Objective\(Effort\) within another"):
        na.Objective.of(na.smoothness(), inner)  # pyright: ignore[reportArgumentType]
    outer = na.Objective.of(na.smoothness(), *inner.terms, *inner.functions)
    assert len(outer.terms) == 2


def test_a_name_loads_what_ships():
    assert na.load_emulator("pendulum-50").spec.substeps == 50
    assert na.load_policy("fish").emulator.spec.system == "fish"


def test_the_pendulums_goal_is_one_of_its_own():
    system = na.load_system("pendulum")
    assert list(system.goals) == ["upright"]
    assert type(na.goal(system, "upright")).__name__ == "ReachState"


@pytest.mark.parametrize("package", PUBLIC)
def test_files_and_folders_may_be_given_as_text(package: str):
    module = importlib.import_module(package)
    functions = [getattr(module, name) for name in dir(module)]
    for function in filter(inspect.isfunction, functions):
        for name, annotation in function.__annotations__.items():
            if "Path" in str(annotation) and name != "return":
                assert "str" in str(annotation), f"{function.__name__}: {name}"


def test_a_clip_goes_where_a_text_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    system = na.load_system("pendulum")
    na.write_glb(
        na.Clip("still", system.skeleton, np.arange(2.0), np.stack(2 * [system.rest])), "a.glb"
    )
    assert Path("a.glb").read_bytes()[:4] == b"glTF"
