"""A model card says what was measured, is a head of YAML and Markdown, and a stranger's words stay words in it."""

from __future__ import annotations

from pathlib import Path

import pytest
from brief import BRIEF
from conftest import Cli

from neuroanimator import load_emulator
from neuroanimator.files.zoo import find_emulator
from neuroanimator.learn.evaluation.evaluate import evaluate
from neuroanimator.learn.evaluation.model_card import write_card
from neuroanimator.learn.evaluation.page import as_markdown


def test_a_card_says_what_it_is_and_what_was_measured(tmp_path: Path):
    file = find_emulator("pendulum-100")
    emulator = load_emulator(file)
    write_card(emulator, file, evaluate(emulator, budget=BRIEF), tmp_path / "card.md")
    card = (tmp_path / "card.md").read_text()
    head, _, body = card.removeprefix("---\n").partition("\n---\n")
    assert "license: apache-2.0" in head.splitlines()
    assert body.lstrip().startswith("# pendulum, n = 100\n")
    titles = [line for line in body.splitlines() if line.startswith("## ")]
    assert titles == [
        "## How it was made", "## How far to trust it", "## State", "## Control", "## Use it",
    ]  # fmt: skip
    assert "| equal error speedup |" in body
    assert "| N·m |" in body.partition("## Control")[2]


def test_one_card_is_of_one_emulator(cli: Cli, tmp_path: Path):
    told = cli("evaluate", "pendulum", "fish", "--card", str(tmp_path / "card.md"))
    assert told.returncode == 2
    assert "evaluate --card: wanted one emulator, got 2." in told.stderr
    assert not (tmp_path / "card.md").exists()


@pytest.mark.attack
def test_a_strangers_words_are_no_markup():
    shown = str(as_markdown("a|b\n# c <script>alert(1)</script> ![x](http://y) `rm` \x1b[2J"))
    assert "\n" not in shown
    assert "\x1b" not in shown
    for sign in "|#<>[]`!":
        assert sign not in shown.replace(f"\\{sign}", "")
