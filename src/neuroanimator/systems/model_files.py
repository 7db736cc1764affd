"""The files of a user's MuJoCo model, MJCF or URDF: read from one folder only."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.systems.model_xml import MAX_FILE, Documents, Source, gather, refuse

PACKAGE_FILE = "package.xml"
"""Name of the file that marks a folder as a ROS package."""

PACKAGE_DEPTH = 4
"""Maximum depth of a model in its package, counting the package's own folder."""

MAX_NAME = 255
"""Maximum number of characters of a file's name, as on most file systems."""

MAX_SHOWN = 40
"""Maximum number of characters of a wrong file name shown in an error."""


@dataclass(frozen=True)
class ModelFiles:
    """A model with every file it needs, as (path relative to its folder, bytes), sorted by path."""

    main: str
    """Path of the model's main file."""
    files: tuple[tuple[str, bytes], ...]
    """(path, bytes) of each file, the main one among them."""

    @cached_property
    def digests(self) -> dict[str, str]:
        """The sha256 of each file, by path."""
        return {name: hashlib.sha256(content).hexdigest() for name, content in self.files}

    def differences(self, digests: Mapping[str, str]) -> list[str]:
        """Return the files that only one side has, or whose sha256 differs in `digests`."""
        every = sorted({*digests, *self.digests})
        return [name for name in every if digests.get(name) != self.digests.get(name)]

    def documents(self) -> Documents:
        """Return the model as given to MuJoCo; BadFileError for what `read_model_files` refuses."""
        return gather(self.main, Source(dict(self.files).get))

    def to_json(self) -> dict[str, Any]:
        """Return what `from_json` reads."""
        texts = {name: base64.b64encode(content).decode() for name, content in self.files}
        return {"main": self.main, "files": texts}

    @classmethod
    def from_json(cls, value: Any) -> ModelFiles:
        """Return the files in a dataset, or in an emulator of an older version; BadFileError if they are damaged."""
        if not _is_main_and_files(value):
            raise BadFileError("The model's files are not {main, files}. Generate and train again.")
        main = value["main"]
        for name in (main, *value["files"]):
            if not 0 < len(name) <= MAX_NAME or not name.isprintable():
                raise BadFileError(
                    f"The model's files: {name[:MAX_SHOWN]!r} is no file name. Rename the file."
                )
        files = []
        for name, text in sorted(value["files"].items()):
            try:
                files.append((name, base64.b64decode(text, validate=True)))
            except ValueError as error:
                raise BadFileError(f"{name}: {error}. Generate and train again.") from error
        return cls(main, tuple(files))


def _is_main_and_files(value: Any) -> bool:
    if not isinstance(value, dict) or not isinstance(value.get("files"), dict):
        return False
    texts = [value.get("main"), *value["files"].values()]
    return all(isinstance(text, str) for text in texts)


def read_model_files(path: Path, tree: Path | None = None) -> ModelFiles:
    """Return the model at `path` with every file it refers to, all from the folder `tree`.

    Without `tree` it is the model's own folder, or its ROS package.

    Raises ArgumentError if the model does not lie in `tree`; BadFileError naming the file and the fault: a path or link
    out of the folder, a missing file, a document type, or anything beyond the limits in `model_xml`.
    """
    allowed = None if tree is None else _checked_tree(path, tree)
    with _reading_named(path.name):
        folder = allowed or _folder_of(path)
        main = (path.parent.resolve() / path.name).relative_to(folder).as_posix()
        source = Source(
            load=lambda name: _read(folder, name),
            where_outside=lambda name: _folder_with(folder, name),
        )
        gather(main, source)
        return ModelFiles(main, tuple(sorted(source.taken.items())))


@contextmanager
def _reading_named(name: str) -> Iterator[None]:
    """Turn errors of reading a model's files into a BadFileError about the file `name`."""
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a loop of links
        raise BadFileError(f"{name}: could not read it: {error}. Check the file.") from error


def _folder_of(path: Path) -> Path:
    """Return the folder from which a model's files are read: its own, or that of its ROS package.

    `package://NAME/` stands for it; only a folder with a `package.xml` counts, so that no model can name another.
    """
    folder = path.parent.resolve()
    for above in (folder, *folder.parents)[:PACKAGE_DEPTH]:
        if (above / PACKAGE_FILE).is_file():
            return above
    return folder


def _checked_tree(path: Path, tree: Path) -> Path:
    """Return the folder `tree`; ArgumentError if the model does not lie in it."""
    folder = tree.resolve()
    if not path.parent.resolve().is_relative_to(folder):
        raise ArgumentError(
            f"tree: {path} does not lie in {tree}. Name a folder that holds the model and its files."
        )
    return folder


def _folder_with(folder: Path, name: str) -> str:
    """Return the folder that holds `folder` and the file `name` outside it; empty if there is no such file.

    Empty, too, for the user's home or a folder above it: nobody should be advised to open that to a model.
    """
    path = (folder / name).resolve()
    if not path.is_file():
        return ""
    common = Path(os.path.commonpath([folder, path]))
    if common == folder:  # the path leaves the folder and returns by its name
        common = folder.parent
    if Path.home().is_relative_to(common):
        return ""
    return str(common)


def _read(folder: Path, name: str) -> bytes | None:
    """Return the bytes of a file in `folder`, at most one more than allowed; None if there is no such file."""
    path = (folder / name).resolve()
    if not path.is_relative_to(folder):
        refuse(name, "", "a link that leaves the model's folder. Put the file itself there")
    if not path.is_file():
        return None
    with open(path, "rb") as file:
        return file.read(MAX_FILE + 1)
