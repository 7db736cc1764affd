"""The notebook runs from the top, as a reader runs it: it learns, shows films below its cells, and its control succeeds."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import pytest
from test_documentation import DOCS, SMALL_FILM

from neuroanimator.film.graphics import graphics_backend
from neuroanimator.film.inline import InlineFilm

NOTEBOOK = DOCS / "quickstart.ipynb"


def cells_of(kind: str) -> list[str]:
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert notebook["nbformat"] == 4
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == kind]


def run_cell(code: str, names: dict[str, Any]) -> Any:
    """Run a cell; return what a notebook shows below it: the value of its last line, if that is an expression."""
    tree = ast.parse(code)
    last = tree.body[-1]
    if not isinstance(last, ast.Expr):
        exec(compile(tree, "cell", "exec"), names)
        return None
    exec(compile(ast.Module(tree.body[:-1], []), "cell", "exec"), names)
    return eval(compile(ast.Expression(last.value), "cell", "eval"), names)


@pytest.mark.endurance  # the README and docs/index.md learn, animate and control, too
def test_the_notebook_learns_animates_and_controls(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("neuroanimator.film.inline.SIZE", SMALL_FILM)
    names: dict[str, Any] = {"__name__": "__main__"}
    shown = [run_cell(code, names) for code in cells_of("code")]
    films = [film for film in shown if isinstance(film, InlineFilm)]
    assert len(films) == 2
    for film in films:
        if graphics_backend() is None:
            assert "No OpenGL to draw with" in film._repr_html_()
        else:
            assert film._repr_html_().startswith("<video")
    assert "upright on MuJoCo: True" in capsys.readouterr().out
    assert (tmp_path / "quickstart" / "swing-up.glb").read_bytes()[:4] == b"glTF"


def test_the_notebook_holds_no_outputs_and_its_links_lead_somewhere():
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert not any(cell.get("outputs") for cell in notebook["cells"])
    targets = [
        part.partition(")")[0] for text in cells_of("markdown") for part in text.split("](")[1:]
    ]
    assert targets
    for target in targets:
        assert (DOCS / target).is_file(), target
