"""A proposed definition with a comment on its values, and the TOML file that holds both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import tomlkit
from tomlkit.container import Container
from tomlkit.items import Table

from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.text import printable

GROUP_HINT = """\
Limbs, or other parts of the body, and their joints: with them 'train --network hierarchy' works.
[groups]
limb = ["JOINT"]"""
"""Comment at the end of a model's TOML file."""

FAMILY_HINT = """\
What varies over a family of bodies, and its range: emulators then know it, and 'neuroanimator identify' finds it.
[parameters]
BODY_mass = { sets = "body/BODY/mass", range = [0.5, 1.5] }"""
"""Comment at the end of a model's TOML file."""

GOAL_HINT = """\
A goal for 'neuroanimator control': a state, or part of one, to reach at the end.
[goals.there]
seconds = 2.0
reach = { "PART" = [1.0] }
within = { "PART" = 0.1 }
PARTs: """
"""Comment at the end of a TOML file that may name goals; the names of the parts follow it."""


SOURCES = {
    Definition: "model",
    PythonDefinition: "file",
    RecordedDefinition: "file",
    SoftDefinition: "mesh",
    FlexDefinition: "model",
}
"""Key of a definition that names its source file."""


@dataclass(frozen=True)
class Proposal:
    """A definition, and notes on it for the user."""

    definition: Definition | FlexDefinition | PythonDefinition | RecordedDefinition | SoftDefinition
    comments: Mapping[str, str]
    """Title of each table of the TOML file, and reason for the value of each key ("table.key")."""
    parts: tuple[str, ...]
    """Names of the parts of the state that goals may name; none where nothing can be controlled."""
    warnings: tuple[str, ...] = ()
    """Warnings for the user, to read before data are generated."""
    told: tuple[tuple[str, str], ...] = ()
    """Further rows for the screen: changes to the model, and results of trial runs."""
    data_seconds: float = 0.0
    """Approximate time of the usual data on one core [s]; 0 if it is unknown, or short."""


def as_toml(proposal: Proposal) -> str:
    """Return the proposal as TOML text, with its comments."""
    definition = proposal.definition
    is_model = isinstance(definition, Definition)
    values = definition.model_dump(mode="json", exclude_none=True, exclude_unset=not is_model)
    for name in ("goals", "groups"):
        values.pop(name, None)
    if not values.get("passive"):
        values.pop("passive", None)
    source_key = SOURCES[type(definition)]
    source = values[source_key].split("/")[-1]
    first = {key: values[key] for key in ("name", "kind", source_key) if key in values}
    document = tomlkit.document()
    _add_comment(
        document,
        f"How NeuroAnimator sees {source}. Edit what you know better; every line is checked when used.",
    )
    _fill(document, first | values, proposal.comments)
    hints = [GROUP_HINT, FAMILY_HINT] if is_model else []
    if proposal.parts:
        hints.append(GOAL_HINT + ", ".join(proposal.parts))
    for hint in hints:
        document.add(tomlkit.nl())
        _add_comment(document, hint)
    return tomlkit.dumps(document)


def _fill(
    container: Container | Table,
    values: Mapping[str, Any],
    comments: Mapping[str, str],
    prefix: str = "",
) -> None:
    """Add `values` to a table, nested tables last; their keys in `comments` begin with `prefix`."""
    for key, value in sorted(values.items(), key=lambda item: _has_tables(item[1])):
        name = prefix + key
        if not _has_tables(value):
            item = tomlkit.item(value)
            if comments.get(name):
                item.comment(printable(comments[name]))
            container.add(key, item)
        elif isinstance(value, list):
            tables = tomlkit.aot()
            for entry in value:
                # The comments on the first hold for all.
                tables.append(_table(entry, {} if len(tables) else comments, name))
            container.add(key, tables)
        elif value:
            container.add(key, _table(value, comments, name))


def _table(values: Mapping[str, Any], comments: Mapping[str, str], name: str) -> Table:
    table = tomlkit.table()
    _add_comment(table, comments.get(name, ""))
    _fill(table, values, comments, f"{name}.")
    return table


def _has_tables(value: object) -> bool:
    """Return whether a value is a table or an array of tables; an empty array is an ordinary value."""
    if isinstance(value, list):
        return any(isinstance(entry, dict) for entry in value)
    return isinstance(value, dict)


def _add_comment(container: Container | Table, text: str) -> None:
    """Add a comment of one line or several; none if `text` is empty."""
    for line in text.splitlines():
        container.add(tomlkit.comment(printable(line)))
