"""What the documents say is true: their code runs, their links and paths lead somewhere, and nothing public is left out.

The blocks of a page run in order, in this process, in a folder of their own: Python as it stands, and those lines of shell
that begin with `neuroanimator`, with fewer samples and updates. A block after "save this as `name`" is written to that file. A
comment right before a block, which readers do not see, says what else to do with it:

    <!-- test: skip, REASON -->      it is not run
    <!-- test: append to NAME -->    it is added to a file
"""

from __future__ import annotations

import re
import runpy
import shlex
import sys
import tomllib
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from brief import BRIEF
from small_trainings import small_training

import neuroanimator.authoring
import neuroanimator.control.policies
import neuroanimator.gym
from neuroanimator.cli.verbs import VERBS, app
from neuroanimator.errors import ResourceError
from neuroanimator.files.zoo import shipped_emulators
from neuroanimator.film.graphics import graphics_backend

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
DECISIONS = DOCS / "decisions"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
DOCUMENTS = [
    *PAGES,
    *(ROOT / name for name in ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md")),
]

BLOCK = re.compile(r"^```(?P<language>\w*)\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL)
MARKER = re.compile(r"<!-- test: (?P<action>skip|append to),? (?P<argument>[^>]+) -->\s*\Z")
FILE = re.compile(r"\b[Ss]ave\b[^`]*\bas `(?P<name>[\w.]+)`")
LINK = re.compile(r"\[[^\]]*\]\((?P<target>[^)\s]+)\)")
HEADING = re.compile(r"^#+ +(?P<title>.+)$", re.MULTILINE)
SOURCE_PATH = re.compile(r"`(?P<path>[\w./-]+/[\w-]+\.(?:py|toml|csv|md|safetensors))`")
REFERENCE = re.compile(r"^::: (?P<name>[\w.]+)$", re.MULTILINE)

SHRUNK = {
    "animate": ("--seconds", "0.5"),
    "generate": ("--count", "1200"),
    "train": small_training(250, "16", 128),
}
"""Options added to a verb, so that it ends soon: of an option given twice the last one counts."""

LONG = (
    "engines.md",
    "families.md",
    "my-mjcf.md",
    "my-python-step.md",
    "my-recordings.md",
    "scale.md",
)
"""Pages that run in `make endurance`: tests/export/programs exports what the first does; tests/learn/identification,
tests/scaffold, tests/systems and tests/executor go the way of the others."""

SMALL_FILM = (160, 90)
"""The size of films in reports [pixels]: what is drawn is what other tests look at."""

WORDS_OF_README = 600
"""The README is what a newcomer reads at one go; everything longer is a page of the site."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    language: str
    code: str
    before: str
    """All of the page's text before it."""

    @property
    def action(self) -> str:
        """What a comment says is to be done with it: "skip", "append to", or nothing."""
        marker = MARKER.search(self.before)
        return marker["action"] if marker else ""

    @property
    def argument(self) -> str:
        """The reason or the file name in that comment."""
        marker = MARKER.search(self.before)
        return marker["argument"] if marker else ""

    @property
    def file(self) -> str:
        """The name a reader is told to save it as; empty if it is not to be saved."""
        paragraph = self.before.rstrip().rpartition("\n\n")[2]
        told = FILE.search(paragraph)
        return told["name"] if told else ""


def blocks_of(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for match in BLOCK.finditer(text):
        yield Block(match["language"], match["code"], text[: match.start()])


def has_code(page: Path) -> bool:
    return any(block.language in ("python", "sh") for block in blocks_of(page))


def id_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def pages_with_code() -> list[Any]:
    """Return every page that has code to run; the long ones run in `make endurance`."""
    return [
        pytest.param(page, marks=[pytest.mark.endurance] if page.name in LONG else ())
        for page in PAGES
        if has_code(page)
    ]


@pytest.mark.parametrize("page", pages_with_code(), ids=id_of)
def test_the_code_of_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # as where a reader starts Python
    monkeypatch.setattr("neuroanimator.learn.evaluation.evaluate.THOROUGH", BRIEF)
    monkeypatch.setattr("neuroanimator.film.inline.SIZE", SMALL_FILM)
    names: dict[str, object] = {"__name__": "__main__"}
    for block in blocks_of(page):
        if block.action == "skip":
            continue
        if block.action == "append to":
            path = tmp_path / block.argument
            path.write_text(f"{path.read_text()}\n{block.code}", encoding="utf-8")
        elif block.file:
            (tmp_path / block.file).write_text(block.code, encoding="utf-8")
        elif block.language == "toml":
            tomllib.loads(block.code)
        elif block.language == "python":
            run_python(block.code, f"{id_of(page)}: a block", names)
        elif block.language == "sh":
            run_shell(block.code, monkeypatch)


def run_python(code: str, name: str, names: dict[str, object]) -> None:
    """Run `code`; where nothing can be drawn, what draws says so."""
    program = compile(code, name, "exec")
    if "render(" in code and graphics_backend() is None:
        with pytest.raises(ResourceError, match="No OpenGL to draw with"):
            exec(program, names)
    else:
        exec(program, names)


def run_shell(code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the lines that are ours by the function behind the command, and `python3 SCRIPT > FILE`."""
    for line in code.splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] == ["python3"]:
            _, script, _, out = words
            with Path(out).open("w", encoding="utf-8") as file, redirect_stdout(file):
                runpy.run_path(script)
        elif words[:1] == ["neuroanimator"]:
            monkeypatch.setattr(sys, "argv", [*words, *SHRUNK.get(words[1], ())])
            with pytest.raises(SystemExit) as ended:
                app()
            assert not ended.value.code, line


def test_every_link_leads_to_something_that_exists():
    for document in DOCUMENTS:
        for target in links_of(document):
            name, _, anchor = target.partition("#")
            path = (document.parent / name).resolve() if name else document
            assert path.exists(), f"{id_of(document)}: {target} leads nowhere"
            if anchor:
                assert anchor in anchors_of(path), f"{id_of(document)}: {target} is no heading"


def links_of(document: Path) -> list[str]:
    """Return the targets of all links and pictures but those on other hosts."""
    text = BLOCK.sub("", document.read_text(encoding="utf-8"))
    targets = [match["target"] for match in LINK.finditer(text)]
    return [target for target in targets if "://" not in target]


def anchors_of(document: Path) -> set[str]:
    """Return the anchors that headings get, on the site as on code hosts."""
    titles = HEADING.findall(BLOCK.sub("", document.read_text(encoding="utf-8")))
    plain = [re.sub(r"[^\w\s-]", "", title.lower()).strip() for title in titles]
    return {re.sub(r"\s+", "-", title) for title in plain}


def test_every_path_named_exists():
    folders = (ROOT, ROOT / "src/neuroanimator", DOCS)
    for document in DOCUMENTS:
        if document.name == "CHANGELOG.md":  # it tells of files as they were
            continue
        for path in SOURCE_PATH.findall(document.read_text(encoding="utf-8")):
            assert any((folder / path).exists() for folder in folders), f"{id_of(document)}: {path}"


@pytest.mark.parametrize(
    "module",
    [
        neuroanimator,
        neuroanimator.authoring,
        neuroanimator.control,
        neuroanimator.control.policies,
        neuroanimator.gym,
    ],
    ids=lambda module: module.__name__,
)
def test_the_reference_has_every_public_name_once(module: ModuleType):
    texts = [page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md")]
    documented = REFERENCE.findall("\n".join(texts))
    assert len(documented) == len({*documented})
    places = (
        "neuroanimator",
        module.__name__,
    )  # what a namespace shares with the package stands there
    for name in module.__all__:
        assert any(f"{place}.{name}" in documented for place in places), name


def test_every_page_can_be_found_on_the_site():
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    named = re.findall(r"[\w/-]+\.md", navigation)
    assert sorted(named) == sorted(page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md"))


def test_the_readme_is_short_and_its_pictures_are_small():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= WORDS_OF_README
    pictures = [ROOT / target for target in links_of(ROOT / "README.md") if target.endswith(".gif")]
    assert pictures
    assert sum(picture.stat().st_size for picture in pictures) < 3_000_000


def test_nothing_is_installed_from_an_index_that_does_not_have_it():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"pip install neuroanimator\b", text), id_of(page)


def test_every_verb_of_the_readme_exists():
    for block in blocks_of(ROOT / "README.md"):
        for verb in re.findall(r"^neuroanimator (\w+)", block.code, re.MULTILINE):
            assert verb in VERBS


def test_every_decision_has_a_number_a_date_and_a_status():
    index = (DECISIONS / "index.md").read_text()
    for page in DECISIONS.glob("[0-9]*.md"):
        title, _, status = page.read_text().split("\n")[:3]
        assert title.startswith(f"# {int(page.name[:4])}. "), page
        assert re.match(r"\*\d{4}-\d\d-\d\d\. (In force|Replaced)", status), page
        assert page.name in index, f"{page.name} is not in the index"


def test_pages_count_the_emulators_that_ship():
    assert len(shipped_emulators()) == 30
    assert "one of 30 that ship" in (ROOT / "README.md").read_text()
    assert "Thirty emulators ship" in (DOCS / "index.md").read_text()
