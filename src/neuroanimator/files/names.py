"""Rules for names of systems, parts of a state or control, and bones, the same in every kind of file.

Names go into tables, reports, files and terminals. So none holds a control character, a line break, a quote, a comma
or a bracket, and none begins like a formula.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated

from pydantic import AfterValidator, Field

from neuroanimator.errors import ArgumentError
from neuroanimator.text import did_you_mean, listed, quoted

SYSTEM_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$"
"""Pattern of the name of a system or goal: no dot and no slash, so that none can be a path."""

PART_PATTERN = r"^[A-Za-z_][A-Za-z0-9_.-]{0,39}$"
"""Pattern of names in a definition: parts, nodes, muscles, groups."""

MAX_LABEL = 80
"""Maximum number of characters of a label."""

LABEL_PATTERN = rf"^\w(?:[\w.:/ -]{{0,{MAX_LABEL - 2}}}[\w.:/-])?$"
"""Pattern of the names of an emulator's parts: those above, with suffixes such as `.velocity`, and names from models."""

MAX_MODEL_NAME = 60
"""Maximum number of characters kept of a model's own name: room for a suffix within `MAX_LABEL` remains."""

MAX_FILE_NAME = 200
"""Maximum number of characters of a file's name."""

MAX_PATH = 1000
"""Maximum number of characters of a file's path."""

SystemName = Annotated[str, Field(pattern=SYSTEM_PATTERN)]
"""The name of a system or goal in a table."""

PartName = Annotated[str, Field(pattern=PART_PATTERN)]
"""The name of a part, node, muscle or group in a table."""


def check_system_name(value: object) -> str:
    """Return `value` if it may be the name of a system; ValueError if not."""
    if not isinstance(value, str) or not re.fullmatch(SYSTEM_PATTERN, value):
        raise ValueError(
            f"system: wanted a name of letters, digits, _ and -, at most 40, got {quoted(value)}"
        )
    return value


def check_label(value: object, what: str) -> str:
    """Return `value` if it may be the name of `what`; ValueError if not."""
    if not isinstance(value, str) or not re.fullmatch(LABEL_PATTERN, value):
        raise ValueError(
            f"{what}: wanted a name of letters, digits and _ . : / -, at most {MAX_LABEL}, got {quoted(value)}"
        )
    return value


def check_known(names: Iterable[str], known: Iterable[str], noun: str, where: str = "") -> None:
    """Raise ArgumentError for the first of `names` that is not among the `known` ones, which it lists.

    `noun` says what they are, and `where` a name was given.
    """
    valid = list(known)
    for name in names:
        if name not in valid:
            begin = f"{where}: no" if where else "No"
            raise ArgumentError(
                f"{begin} {noun} called {quoted(name)}. {did_you_mean(name, valid)}"
                f"{noun.capitalize()}s: {listed(valid) or 'none'}."
            )


def refuse_twins(names: Iterable[str], what: str) -> None:
    """Raise ArgumentError if two of `names` are the same."""
    earlier: set[str] = set()
    for name in names:
        if name in earlier:
            raise ArgumentError(f"{what}: two parts are called {quoted(name)}. Rename one of them.")
        earlier.add(name)


def model_name(text: str, otherwise: str) -> str:
    """Return a model's name for something as a label, `otherwise` if it has no name.

    Models may come from strangers, and their format allows any text: characters not allowed in a label become `_`.
    """
    allowed = re.sub(r"[^\w.:/ -]", "_", text)
    name = allowed.strip()[:MAX_MODEL_NAME].strip()
    if not name:
        return otherwise
    if not re.match(r"\w", name):
        return "_" + name
    return name


def _check_file_name(value: str) -> str:
    is_plain = value.isprintable() and "/" not in value and "\\" not in value
    if not is_plain or value in ("", ".", "..") or len(value) > MAX_FILE_NAME:
        raise ValueError("wanted the name of a file beside it")
    return value


FileName = Annotated[str, AfterValidator(_check_file_name)]
"""The name of a file beside its definition: no path."""


def _check_model_path(value: str) -> str:
    is_plain = value.isprintable() and "\\" not in value and 0 < len(value) <= MAX_PATH
    if not is_plain or value.endswith("/") or ".." in value.split("/"):
        raise ValueError("wanted a file in the folder of this one, or an absolute path")
    return value


ModelPath = Annotated[str, AfterValidator(_check_model_path)]
"""The path of a model: in the folder of its definition, or absolute. A definition from elsewhere has no absolute one."""


def check_file_name(value: object) -> str:
    """Return `value` if it may be the name of a file beside its definition; ValueError if not."""
    if not isinstance(value, str):
        raise ValueError(f"wanted the name of a file, got {quoted(value)}")
    return _check_file_name(value)
