"""Read and check the JSON text by which datasets and emulators state the user's system they belong to.

No system is made from it here.

It comes from files that strangers may have written, so it is held to the rules of a TOML file, and can only
*name* a model, a step function or recordings, by the sha256 of their bytes: see `systems/trusted_files.py`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

from neuroanimator.definitions.body import BodyDefinition
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.files.json_text import MAX_DEFINITION, parse_json_object
from neuroanimator.files.names import check_file_name
from neuroanimator.files.numbers import listed, whole
from neuroanimator.files.tables import check_table
from neuroanimator.text import quoted

TABLES: dict[str, type[Any]] = {
    "mujoco": Definition,
    "mass-spring": BodyDefinition,
    "python": PythonDefinition,
    "recorded": RecordedDefinition,
    "soft": SoftDefinition,
    "flex": FlexDefinition,
}
"""Table that definitions of each kind are checked against."""

AIMS = frozenset(("task", "follow"))
"""Tables that define a policy's aim, which is no physics."""

SPLIT = 2
"""Version of how recordings are cut, raised whenever other stretches of them are held out."""

SHA256 = r"[0-9a-f]{64}"
"""Pattern of a sha256."""

MAX_PATH = 255
"""Maximum number of characters of a path in a model's folder."""

MAX_ROWS = 10**9
"""Maximum number of rows of a recorded run."""

MAX_ORIGIN = 40
"""Maximum number of characters of a text that says where in its file a recorded run begins."""

DAMAGED = "The system's definition is damaged"
"""Beginning of errors about a carried definition."""

DT_TOLERANCE = 1e-6
"""Tolerance of a super step as a whole number of physics steps, relative: floating-point rounding."""


class Written(NamedTuple):
    """A definition and what is carried with it."""

    kind: str
    definition: Any
    """The checked table, one of `TABLES`, by `kind`."""
    files: Any
    """JSON values: for a model the names of the TOML file and the main file, and the sha256 of each file; for a step
    function, recordings or shapes their name and sha256; for a flex both, as `model` and `shapes`. Older versions had the
    model's files here, in base64."""


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


_FOLDERS: dict[str, list[Path]] = {}


def remember_folder(text: str, folder: Path) -> None:
    """Remember that a file of the system in the JSON `text` is in `folder`: its model may be beside it."""
    folders = _FOLDERS.setdefault(text, [])
    if folder not in folders:
        folders.append(folder)


def remembered_folders(text: str) -> list[Path]:
    """Return the folders of all files of the system in the JSON `text` that this process has read."""
    return _FOLDERS.get(text, [])


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
    """Return the part of the definition in the JSON `text` that datasets depend on; any other text unchanged.

    Goals and tasks are no physics, nor is the TOML file's name. How recordings are cut into training and test
    segments is part of their data.
    """
    try:
        values = parse_json_object(text, MAX_DEFINITION)
    except ValueError:
        return text
    definition = values.get("definition")
    if not isinstance(definition, dict):
        return text
    if definition.get("goals") or not AIMS.isdisjoint(definition):
        physics = {key: value for key, value in definition.items() if key not in AIMS}
        values |= {"definition": physics | {"goals": {}}}
        text = canonical_json(values)
    files = values.get("files")
    if isinstance(files, dict) and "toml" in files:
        text = canonical_json(values | {"files": files | {"toml": ""}})
    if isinstance(files, dict) and isinstance(files.get("model"), dict):
        nameless = files["model"] | {"toml": ""}
        text = canonical_json(values | {"files": files | {"model": nameless}})
    if definition.get("kind") == "recorded":
        text += f" split {SPLIT}"
    return text


def _check_files(kind: str, files: Any) -> None:
    """Raise ValueError, KeyError or TypeError unless `files` names the files of a definition of this kind."""
    if kind == "mujoco" and not is_whole_model(files):
        _check_model_files(files)
    if kind == "flex":
        _check_model_files(files["model"])
        files = files["shapes"]
    if kind not in ("python", "recorded", "soft", "flex"):
        return
    check_file_name(files["name"])
    _check_digest(files["sha256"])
    if kind == "recorded":
        listed(files["rows"], "files.rows", lambda count, what: whole(count, what, 1, MAX_ROWS))
        listed(files["origins"], "files.origins", _check_origin)
        if len(files["rows"]) != len(files["origins"]):
            raise ValueError(f"files: {len(files['rows'])} runs, {len(files['origins'])} origins")


def is_whole_model(files: Any) -> bool:
    """Return whether `files` holds a model's files themselves, as older versions wrote them."""
    return isinstance(files, dict) and "files" in files


def _check_model_files(files: Any) -> None:
    check_file_name(files["toml"])
    digests = files["sha256"]
    if not isinstance(digests, dict) or files["main"] not in digests:
        raise ValueError("files: wanted the sha256 of each, the main one's among them")
    for name, digest in digests.items():
        if not name.isprintable() or len(name) > MAX_PATH:
            raise ValueError(f"files: {quoted(name)} is no path")
        _check_digest(digest)


def _check_digest(value: Any) -> None:
    if not isinstance(value, str) or not re.fullmatch(SHA256, value):
        raise ValueError(f"files.sha256: wanted 64 hex digits, got {quoted(value)}")


def _check_origin(value: Any, what: str) -> str:
    if not isinstance(value, str) or not value.isprintable() or len(value) > MAX_ORIGIN:
        raise ValueError(f"{what}: wanted where a run begins, got {quoted(value)}")
    return value


def check_carried(system: str, text: str, substeps: int, dt: float) -> None:
    """Refuse a definition carried by an emulator of another system, or of another super step.

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
