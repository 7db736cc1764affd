"""What messages advise can be done: every command, option, extra and target that they name is there."""

from __future__ import annotations

import re
import shlex
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from conftest import Cli
from messages import all_messages
from typer.main import get_command

from neuroanimator.cli.verbs import app
from neuroanimator.files.sources import SOURCES
from neuroanimator.scaffold.write_toml import KINDS

ROOT = Path(__file__).parents[1]

MESSAGES = all_messages()

OTHERS_OPTIONS = {"--head"}
"""Options in messages that are of other programs."""

ROBOT = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping="1"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.05"/></body></worldbody>
  <actuator><motor name="turn" joint="hinge" ctrlrange="-1 1"/></actuator></mujoco>"""


@cache
def verbs() -> dict[str, Any]:
    group: Any = get_command(app)
    return dict(group.commands.items())


def options_of(verb: str) -> set[str]:
    every = {"--help"}
    for parameter in verbs()[verb].params:
        every |= {*parameter.opts, *parameter.secondary_opts}
    return every


def commands_in(message: str) -> list[list[str]]:
    """Return the words of each command in a message: after our name, or in quotes and beginning with a verb."""
    found = re.findall(r"(?<!import )neuroanimator ([a-z]+(?: [^\s';,()]+)*)", message)
    found += re.findall(rf"'((?:{'|'.join(verbs())})(?: [^']*)?)'", message)
    return [text.replace("\\n", " ").rstrip(".:").split() for text in found]


ADVISED = sorted({" ".join(words) for message in MESSAGES for words in commands_in(message)})


def test_commands_are_found_in_messages():
    assert len(ADVISED) > 25
    assert commands_in("Write it again: neuroanimator new {} --force") == [["new", "{}", "--force"]]
    assert commands_in("'train --network hierarchy' works.") == [
        ["train", "--network", "hierarchy"]
    ]


@pytest.mark.parametrize("command", ADVISED)
def test_a_command_in_a_message_has_a_verb_and_options_that_exist(command: str):
    verb, *words = command.split()
    assert verb in verbs(), command
    options = {word.split("=")[0] for word in words if word.startswith("--")}
    assert options <= options_of(verb), command


def test_an_option_in_a_message_is_one_of_a_verb():
    known = set().union(*map(options_of, verbs()), OTHERS_OPTIONS)
    for message in MESSAGES:
        named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", message))
        assert named <= known, message


def test_what_messages_tell_to_install_or_make_is_there():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    makefile = (ROOT / "Makefile").read_text()
    extras = set()
    for message in MESSAGES:
        extras |= set(re.findall(r"pip install '?neuroanimator\[(\w+)\]", message))
        for target in re.findall(r"repository: make (\w+)", message):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), message
    assert extras <= set(project["optional-dependencies"])
    # No index has this package itself: pip finds an extra's packages only if they are all of others.
    for extra in extras:
        assert not any("neuroanimator" in name for name in project["optional-dependencies"][extra])


def test_a_file_that_new_reads_is_told_from_one_that_is_damaged():
    assert {*KINDS, ".xml", ".urdf"} == set(SOURCES)


@pytest.mark.parametrize("verb", ["train", "generate", "policy", "evaluate", "info", "animate"])
def test_a_model_leads_to_the_command_that_comes_first(verb: str, cli: Cli, tmp_path: Path):
    (tmp_path / "my robot.xml").write_text(ROBOT)
    more = () if verb in ("evaluate", "info") else ("--out", "made.glb")
    asked = cli(verb, "my robot.xml", *more, cwd=tmp_path)
    assert asked.returncode == 3
    told = re.search(r"first: neuroanimator (.*)", asked.stderr)
    assert told is not None, asked.stderr
    assert shlex.split(told[1]) == ["new", "my robot.xml"]


def test_the_first_command_leads_to_the_next_until_there_is_an_emulator(cli: Cli, tmp_path: Path):
    (tmp_path / "my_robot.xml").write_text(ROBOT)
    seen = []
    words = ["evaluate", "my_robot.xml"]
    for _ in range(2):
        asked = cli(*words, cwd=tmp_path)
        told = re.search(
            r"first: neuroanimator (.*)|then: neuroanimator (.*)", asked.stderr + asked.stdout
        )
        assert told is not None, asked.stderr
        words = shlex.split(told[1] or told[2])
        seen.append(words[0])
    assert seen == ["new", "train"]
    asked = cli("evaluate", "my_robot.toml", cwd=tmp_path)
    assert f"first: neuroanimator {' '.join(words)}" in asked.stderr
