"""Models from strangers, MJCF or URDF: read from one folder only, checked, and compiled from memory."""

from __future__ import annotations

import base64
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import mujoco

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.systems.rigid.model_safety import check_cells, check_elements, check_model
from neuroanimator.systems.rigid.model_xml import (
    FILE_LIMIT,
    Element,
    Source,
    attach_files,
    expand,
    parse,
    refuse,
    refuse_at,
)
from neuroanimator.systems.rigid.urdf import compile_urdf

URDF_PARTS = {"link", "joint", "material", "mujoco"}
"""What MuJoCo reads of a URDF; the rest, such as <gazebo>, is dropped."""

COLOR_SIZE = 4
"""A colour is red, green, blue and opacity."""

MACRO = "xacro:"
"""The tags of xacro, the language most URDFs are made with, begin so."""

PACKAGE_FILE = "package.xml"
"""A folder that holds this file is a ROS package."""

PACKAGE_DEPTH = 4
"""A model may lie so deep in its package, the package's own folder counted."""

MAX_NAME = 255
"""A file's name may have so many characters, as on most file systems."""

MAX_SHOWN = 40
"""An error shows so many characters of a wrong file name."""

MAX_MESSAGE = 300
"""An error shows so many characters of what MuJoCo says."""


@dataclass(frozen=True)
class ModelFiles:
    """A model with every file it needs, as (path relative to its folder, base64 of the bytes), sorted by path."""

    main: str
    """The path of the file that describes the model."""
    files: tuple[tuple[str, str], ...]
    """(path, base64 of the bytes) of each file, the main one among them."""

    def to_json(self) -> dict[str, Any]:
        """Return what `from_json` reads."""
        return {"main": self.main, "files": dict(self.files)}

    @classmethod
    def from_json(cls, value: Any) -> ModelFiles:
        """Return the files `value` holds; raises BadFileError if it is not what `to_json` returns."""
        if not _is_main_and_files(value):
            raise BadFileError(
                "The model's files are not {main, files}. Read them again with read_model_files."
            )
        main = value["main"]
        files = value["files"]
        for name in (main, *files):
            if not 0 < len(name) <= MAX_NAME or not name.isprintable():
                raise BadFileError(
                    f"The model's files: {name[:MAX_SHOWN]!r} is no file name. Rename the file."
                )
        return cls(main, tuple(sorted(files.items())))


def _is_main_and_files(value: Any) -> bool:
    if not isinstance(value, dict) or not isinstance(value.get("files"), dict):
        return False
    texts = [value.get("main"), *value["files"].values()]
    return all(isinstance(text, str) for text in texts)


def read_model_files(path: Path, tree: Path | None = None) -> ModelFiles:
    """Return the model at `path` with every file it refers to, all from the folder `tree`; compiles nothing.

    Without `tree` that is the model's own folder, or the ROS package it lies in.

    Raises ArgumentError if the model does not lie in `tree`; BadFileError naming the file and the fault: a path or link
    out of the folder, a missing file, a document type, an unsupported element, or anything beyond the limits in
    `model_xml` and `model_safety`.
    """
    allowed = None if tree is None else _checked_tree(path, tree)
    try:
        folder = allowed or _folder_of(path)
        main = (path.parent.resolve() / path.name).relative_to(folder).as_posix()
        source = Source(
            load=lambda name: _read(folder, name),
            where_outside=lambda name: _folder_with(folder, name),
        )
        _assemble(main, source)
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a circle of links
        raise BadFileError(f"{path.name}: could not read it: {error}. Check the file.") from error
    files = []
    for name in sorted(source.taken):
        text = base64.b64encode(source.taken[name]).decode()
        files.append((name, text))
    return ModelFiles(main, tuple(files))


def _folder_of(path: Path) -> Path:
    """Return the folder a model's files are read from: its own, or that of the ROS package it lies in.

    `package://NAME/` stands for it; only a folder with a `package.xml` counts, so that no model can name any other.
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
    """Return the folder that holds `folder` and the file `name` outside of it; empty if there is no such file.

    Empty, too, if that were the user's home or a folder above it: nobody should be told to open that to a model.
    """
    path = (folder / name).resolve()
    if not path.is_file():
        return ""
    common = Path(os.path.commonpath([folder, path]))
    if Path.home().is_relative_to(common):
        return ""
    return str(common)


def _read(folder: Path, name: str) -> bytes | None:
    """Return the bytes of a file in `folder`, one more than allowed at most; None if there is no such file."""
    path = (folder / name).resolve()
    if not path.is_relative_to(folder):
        refuse(name, "", "a link that leaves the model's folder. Put the file itself there")
    if not path.is_file():
        return None
    with open(path, "rb") as file:
        return file.read(FILE_LIMIT + 1)


def compile_model(files: ModelFiles, base: Literal["fixed", "free"] = "fixed") -> mujoco.MjModel:
    """Return the model compiled from memory, with MuJoCo's silent resets of NaN states off.

    A URDF gets its motors, and its root stands fixed or free as `base` says; see `urdf`.
    Raises BadFileError naming the file and the fault: all that `read_model_files` refuses, what MuJoCo
    refuses, no joints, a time step outside (0, 0.1] s, an infinite number or NaN in the compiled model,
    or more bodies, freedoms or memory than supported.
    """
    stored = dict(files.files)

    def load(name: str) -> bytes | None:
        if name not in stored:
            return None
        return base64.b64decode(stored[name], validate=True)

    source = Source(load)
    try:
        root, assets = _assemble(files.main, source)
        with _quiet():
            text = ET.tostring(root, encoding="unicode")
            if root.tag == "robot":
                model = compile_urdf(root, text, assets, base)
            else:
                model = mujoco.MjModel.from_xml_string(text, assets)
    except (ValueError, RuntimeError, mujoco.FatalError, MemoryError) as error:
        # MuJoCo's line numbers count in the text without includes, so they would mislead.
        line = " ".join(str(error).split())
        message = re.sub(r",? ?\(?line =? ?\d+\)?", "", line)[:MAX_MESSAGE]
        raise BadFileError(f"{files.main}: {message}. Correct the model.") from error
    check_model(files.main, model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return model


def _assemble(main: str, source: Source) -> tuple[Element, dict[str, bytes]]:
    """Return (one checked XML tree without includes, its assets by the names the tree gives them)."""
    content = source.take(main)
    if content is None:
        refuse(main, "", "no such file. Check the path")
    root = parse(source, main, content)
    expand(source, root, (main,), {main})
    settings = _take_settings(root)
    if root.tag == "robot":
        _trim_urdf(root, settings)
    check_elements(root)
    assets = attach_files(source, main, root, settings)
    check_cells(root, assets)
    return root, assets


def _take_settings(root: Element) -> dict[str, str]:
    """Return what the <compiler> elements set; what they say of paths is removed, as `attach_files` follows it."""
    settings: dict[str, str] = {}
    for compiler in root.iter("compiler"):
        settings |= compiler.attrib
        for name in ("assetdir", "meshdir", "texturedir", "strippath"):
            compiler.attrib.pop(name, None)
    return settings


def _trim_urdf(root: Element, settings: dict[str, str]) -> None:
    """Remove what MuJoCo does not read of a URDF, so that it needs no files for it; macros of xacro are refused."""
    for element in root.descendants():
        if element.tag.startswith(MACRO):
            refuse_at(
                element,
                "",
                "xacro's macros are not expanded. Run `xacro` on the file, and take what it writes",
            )
    root[:] = [child for child in root if child.tag in URDF_PARTS]
    for texture in root.iter("texture"):
        texture.attrib.clear()
    for material in root.descendants():
        # A colour of three numbers, or of five, is no reason to refuse a robot.
        if material.tag == "material":
            material[:] = [child for child in material if _is_color(child)]
    if settings.get("discardvisual", "true") == "true":
        for visual in root.iter("visual"):
            visual[:] = [child for child in visual if child.tag != "geometry"]


def _is_color(element: ET.Element) -> bool:
    """Return whether an element of a material is anything but a colour that is not four numbers."""
    return element.tag != "color" or len(element.get("rgba", "").split()) == COLOR_SIZE


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep MuJoCo's warnings off the console and out of a MUJOCO_LOG.TXT in the current folder."""
    before = mujoco.MjLogConfig.get()
    quiet = mujoco.MjLogConfig.get()
    quiet.logto_file = False
    quiet.logto_console = False
    mujoco.MjLogConfig.set(quiet)
    try:
        yield
    finally:
        mujoco.MjLogConfig.set(before)
