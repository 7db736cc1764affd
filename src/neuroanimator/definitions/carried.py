"""Read and check the JSON text that holds a user's own system inside its datasets and emulators.

No system is made of it here.

It comes out of files that strangers may have written, so it is held to the rules of a TOML file, and it can only
*name* a step function or recordings. What it names is opened where the user allows it, see `systems/trusted_files.py`.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from neuroanimator.definitions.body import BodyDefinition
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.parsing.json_text import MAX_DEFINITION, parse_json_object
from neuroanimator.parsing.names import check_file_name
from neuroanimator.parsing.numbers import listed, whole
from neuroanimator.storage.files import canonical_json
from neuroanimator.tables import check_table
from neuroanimator.text import quoted

TABLES: dict[str, type[Any]] = {
    "mujoco": Definition,
    "mass-spring": BodyDefinition,
    "python": PythonDefinition,
    "recorded": RecordedDefinition,
}
"""A definition of each kind is checked against this table."""

SPLIT = 2
"""Number of the way recordings are cut: raised whenever other stretches of them are held out."""

SHA256 = r"[0-9a-f]{64}"
"""A sha256 is written like this."""

MAX_ROWS = 10**9
"""A recorded run may have this many rows."""

MAX_ORIGIN = 40
"""This many characters may say where in its file a recorded run begins."""

DAMAGED = "The system's definition is damaged"
"""Errors about a definition that travelled begin like this."""

DT_TOLERANCE = 1e-6
"""A super step may be off the whole number of physics steps it is by this share of it: floating-point rounding."""


class Written(NamedTuple):
    """A definition and what travels with it."""

    kind: str
    definition: Any
    """The checked table, one of `TABLES`, by `kind`."""
    files: Any
    """JSON values: a model's files; of a step function or recordings their name and sha256."""


def kind_of(values: Any) -> str:
    """Return the kind of system a table defines; ArgumentError lists the kinds."""
    name = values
    if isinstance(values, dict):
        name = values.get("kind", "mujoco")
    if not isinstance(name, str) or name not in TABLES:
        raise ArgumentError(
            f"kind: no kind of system called {quoted(name)}. Kinds: {', '.join(TABLES)}."
        )
    return name


def read_definition_text(text: str) -> Written:
    """Return the definition in the JSON `text`; ArgumentError or BadFileError names what is wrong with it."""
    if len(text) > MAX_DEFINITION:
        raise BadFileError(
            f"{DAMAGED}: {len(text):,} characters; wanted at most {MAX_DEFINITION:,}."
        )
    try:
        values = parse_json_object(text, MAX_DEFINITION)
        definition = values["definition"]
        files = values["files"]
    except (ValueError, KeyError, TypeError) as error:
        raise BadFileError(f"{DAMAGED}. Make the dataset or emulator again.") from error
    kind = kind_of(definition)
    checked = check_table(definition, "definition", TABLES[kind])
    try:
        _check_files(kind, files)
    except (ValueError, KeyError, TypeError) as error:
        raise BadFileError(f"{DAMAGED}: {error}. Make the dataset or emulator again.") from error
    return Written(kind, checked, files)


def data_identity(text: str) -> str:
    """Return what datasets depend on of the definition in the JSON `text`; a text that is none as it is.

    Goals are no physics. How recordings are cut into what is learnt from and what is tested is part of their data.
    """
    try:
        values = parse_json_object(text, MAX_DEFINITION)
    except ValueError:
        return text
    definition = values.get("definition")
    if not isinstance(definition, dict):
        return text
    if definition.get("goals"):
        text = canonical_json(values | {"definition": definition | {"goals": {}}})
    if definition.get("kind") == "recorded":
        text += f" split {SPLIT}"
    return text


def _check_files(kind: str, files: Any) -> None:
    """Raise ValueError, KeyError or TypeError unless `files` names a file as a definition of this kind does."""
    if kind not in ("python", "recorded"):
        return
    check_file_name(files["name"])
    if not isinstance(files["sha256"], str) or not re.fullmatch(SHA256, files["sha256"]):
        raise ValueError(f"files.sha256: wanted 64 hex digits, came {quoted(files['sha256'])}")
    if kind == "recorded":
        listed(files["rows"], "files.rows", lambda count, what: whole(count, what, 1, MAX_ROWS))
        listed(files["origins"], "files.origins", _check_origin)
        if len(files["rows"]) != len(files["origins"]):
            raise ValueError(f"files: {len(files['rows'])} runs, {len(files['origins'])} origins")


def _check_origin(value: Any, what: str) -> str:
    if not isinstance(value, str) or not value.isprintable() or len(value) > MAX_ORIGIN:
        raise ValueError(f"{what}: wanted where a run begins, came {quoted(value)}")
    return value


def check_carried(system: str, text: str, substeps: int, dt: float) -> None:
    """Refuse a definition that travels with an emulator of another system, or of another super step.

    Raises ArgumentError, BadFileError or ValueError.
    """
    definition = read_definition_text(text).definition
    if definition.name != system:
        raise ValueError(f"definition: of the system '{definition.name}', not '{system}'")
    whole_dt = substeps * definition.physics.step
    if abs(whole_dt - dt) > DT_TOLERANCE * dt:
        raise ValueError(
            f"dt: {substeps} physics steps of {definition.physics.step:g} s make no super step of {dt:g} s"
        )
