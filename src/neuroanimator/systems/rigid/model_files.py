"""Models from strangers, MJCF or URDF: read from one folder only, checked, and compiled from memory."""

from __future__ import annotations

import base64
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np

from neuroanimator.errors import ArgumentError, BadFileError, NeuroAnimatorError
from neuroanimator.executor.limited import LimitError, ProcessLimits, call_limited
from neuroanimator.parsing.json_text import MAX_DEFINITION
from neuroanimator.systems.rigid.light_model import Assets, lighten, without_pictures
from neuroanimator.systems.rigid.model_safety import (
    MEMORY_LIMIT,
    check_cells,
    check_elements,
    check_model,
)
from neuroanimator.systems.rigid.model_trial import try_model
from neuroanimator.systems.rigid.model_xml import (
    CARRIED,
    ON_DISK,
    Element,
    Limits,
    Source,
    TooLargeError,
    attach_files,
    expand,
    parse,
    refuse,
    refuse_at,
)
from neuroanimator.systems.rigid.urdf import add_what_moves
from neuroanimator.systems.rigid.warnings import warnings_counted

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

DEFINITION_ROOM = 64 * 1024
"""Part of the text that travels with an emulator left to the definition [bytes]."""

MAX_NAME = 255
"""Maximum number of characters of a file's name, as on most file systems."""

MAX_SHOWN = 40
"""Maximum number of characters of a wrong file name shown in an error."""

MAX_MESSAGE = 300
"""Maximum number of characters of what MuJoCo says shown in an error."""


COMPILING = ProcessLimits(memory=2 * 2**30, seconds=60)
"""How much the process may take that compiles a model as it travels: a few megabytes of files."""

LIGHTENING = ProcessLimits(memory=4 * 2**30, seconds=300)
"""How much the process may take that makes a model of the user's disk light: up to 64 MB of meshes, compiled several times."""

OUT_OF_MEMORY = ("Could not allocate memory", "unknown exception")
"""Parts of what MuJoCo says where it gets no memory."""

COMPILED = "compiled.mjb"
"""Name under which MuJoCo finds a compiled model in memory."""

COMPILED_KEPT = 4
"""Number of compiled models kept: a user's own is loaded more than once."""

ADVICE = {
    "no decoder found": "MuJoCo reads STL, OBJ and MSH: convert the mesh, or put a primitive shape in its place",
    "ASCII": "Save the mesh as a binary STL",
    "balanceinertia": 'Correct the inertia, or add <compiler balanceinertia="true"/> (in a URDF inside of <mujoco>)',
    "positive eigenvalues": "Correct the inertia: no body has a negative one",
    "mjMINVAL": 'Give the body a mass, or add <compiler boundmass="1e-4" boundinertia="1e-7"/> (in a URDF inside of <mujoco>)',
    "mujocoinclude": "It is a part of other models: name one that includes it",
}
"""What to do about some of MuJoCo's refusals, by a part of what it says."""


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


class ReadModel(NamedTuple):
    """A model as an emulator file carries it, and what was left out of it."""

    files: ModelFiles
    note: str
    """What became of textures and meshes, in words; empty if nothing was left out."""


def read_model_files(path: Path, tree: Path | None = None) -> ModelFiles:
    """Return the files of the model at `path` as an emulator file carries them; see `read_model`."""
    return read_model(path, tree).files


def read_model(path: Path, tree: Path | None = None) -> ReadModel:
    """Return the model at `path` with every file it refers to, all from the folder `tree`.

    Without `tree` that is the model's own folder, or the ROS package it lies in. A model too large for an emulator file
    is made light, see `light_model`.

    Raises ArgumentError if the model does not lie in `tree`; BadFileError naming the file and the fault: a path or link
    out of the folder, a missing file, a document type, an unsupported element, or anything beyond the limits in
    `model_xml` and `model_safety`.
    """
    allowed = None if tree is None else _checked_tree(path, tree)
    with _reading_named(path.name):
        folder = allowed or _folder_of(path)
        main = (path.parent.resolve() / path.name).relative_to(folder).as_posix()
        try:
            source = _source_in(folder, CARRIED)
            _assemble(main, source)
            if _fits(source.taken):
                return ReadModel(_packed(main, source.taken), "")
        except TooLargeError:
            pass
    with _limits_named(main):
        return call_limited(_read_light, (main, folder), LIGHTENING)


@contextmanager
def _reading_named(name: str) -> Iterator[None]:
    """Raise what keeps a model's files from being read as a BadFileError about the file `name`."""
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: a circle of links
        raise BadFileError(f"{name}: could not read it: {error}. Check the file.") from error


def _source_in(folder: Path, limits: Limits) -> Source:
    """Return what reads files of a folder."""
    return Source(
        load=lambda name: _read(folder, name, limits.file),
        limits=limits,
        where_outside=lambda name: _folder_with(folder, name),
    )


def _fits(files: Assets) -> bool:
    """Return whether files travel with an emulator: they are written in base64, four characters for three bytes."""
    characters = sum(len(content) for content in files.values()) * 4 / 3
    return characters + DEFINITION_ROOM <= MAX_DEFINITION


def _packed(main: str, files: Assets) -> ModelFiles:
    """Return the files as text."""
    texts = []
    for name in sorted(files):
        texts.append((name, base64.b64encode(files[name]).decode()))
    return ModelFiles(main, tuple(texts))


def _read_light(given: tuple[str, Path]) -> ReadModel:
    """Return the model of (its main file, its folder) without its textures, its meshes made light."""
    main, folder = given
    source = _source_in(folder, ON_DISK)
    with _reading_named(main):
        root, settings = _read_tree(main, source)
        pictures = without_pictures(root)
        assets = attach_files(source, main, root, settings)
    check_cells(root, assets)
    with _faults_named(main):
        light = lighten(main, root, assets, _compiled_tree, _fits, pictures)
    return ReadModel(_packed(PurePosixPath(main).name, light.files), light.note)


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
    if common == folder:  # the path leaves the folder and comes back by its name
        common = folder.parent
    if Path.home().is_relative_to(common):
        return ""
    return str(common)


def _read(folder: Path, name: str, limit: int) -> bytes | None:
    """Return the bytes of a file in `folder`, one more than `limit` at most; None if there is no such file."""
    path = (folder / name).resolve()
    if not path.is_relative_to(folder):
        refuse(name, "", "a link that leaves the model's folder. Put the file itself there")
    if not path.is_file():
        return None
    with open(path, "rb") as file:
        return file.read(limit + 1)


class ModelRequest(NamedTuple):
    """A model to be compiled."""

    files: ModelFiles
    base: Literal["fixed", "free"] = "fixed"
    """How a URDF's root stands."""
    passive: tuple[str, ...] = ()
    """Joints of a URDF that get no motor."""


def compile_model(
    files: ModelFiles,
    base: Literal["fixed", "free"] = "fixed",
    passive: tuple[str, ...] = (),
) -> mujoco.MjModel:
    """Return the compiled model, with MuJoCo's silent resets of NaN states off.

    It was compiled, and tried for a moment, by a process of its own that a crash or a lack of memory ends instead of
    this one. MuJoCo's working memory is as large as any model's may be: memory that nothing touches costs nothing.
    A URDF gets its motors, but for joints that are `passive`, and its root stands fixed or free as `base` says; see `urdf`.
    Raises BadFileError naming the file and the fault: all that `read_model_files` refuses, what MuJoCo
    refuses, no joints, a time step outside (0, 0.1] s, an infinite number or NaN in the compiled model,
    more bodies, freedoms, memory or time than supported, or what MuJoCo cannot simulate.
    """
    content = _compiled(ModelRequest(files, base, passive))
    return mujoco.MjModel.from_binary_path(COMPILED, {COMPILED: content})


@lru_cache(COMPILED_KEPT)
def _compiled(request: ModelRequest) -> bytes:
    """Return the compiled model as MuJoCo writes it, made within limits."""
    with _limits_named(request.files.main):
        return call_limited(compile_here, request, COMPILING)


def compile_here(request: ModelRequest) -> bytes:
    """Return the compiled model as MuJoCo writes it, made in this very process."""
    files, base, passive = request
    stored = dict(files.files)

    def load(name: str) -> bytes | None:
        if name not in stored:
            return None
        return base64.b64decode(stored[name], validate=True)

    source = Source(load)
    try:
        root, assets = _assemble(files.main, source)
    except ValueError as error:  # no base64
        raise BadFileError(f"{files.main}: {error}. Correct the model.") from error
    with _faults_named(files.main):
        model = _compiled_tree(root, assets, base=base, passive=passive)
    check_model(files.main, model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    try:
        with warnings_counted:
            try_model(model)
    except BadFileError as error:
        raise BadFileError(f"{files.main}: {error}") from error
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


@contextmanager
def _limits_named(main: str) -> Iterator[None]:
    """Raise that a call took too much as a BadFileError about the file `main`."""
    try:
        yield
    except LimitError as error:
        raise BadFileError(
            f"{main}: compiling it {error}. Use fewer or simpler meshes, and smaller pictures."
        ) from error


@contextmanager
def _faults_named(main: str) -> Iterator[None]:
    """Raise what MuJoCo raises as a BadFileError about the file `main`."""
    try:
        yield
    except NeuroAnimatorError:
        raise
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        # MuJoCo's line numbers count in the text without includes, so they would mislead.
        line = " ".join(str(error).split())
        message = re.sub(r",? ?\(?line =? ?\d+\)?", "", line)[:MAX_MESSAGE]
        if any(part in message for part in OUT_OF_MEMORY):
            raise MemoryError from error
        advice = "Correct the model"
        for part, better in ADVICE.items():
            if part in message:
                advice = better
        raise BadFileError(f"{main}: {message.rstrip('. ')}. {advice}.") from error


def _compiled_tree(
    root: Element,
    assets: Assets,
    hull_corners: int = 0,
    base: Literal["fixed", "free"] = "fixed",
    passive: tuple[str, ...] = (),
) -> mujoco.MjModel:
    """Return the model of an XML tree, hulls of meshes cut down to `hull_corners` if that is no 0."""
    with _quiet():
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"), assets=assets)
        spec.memory = MEMORY_LIMIT
        # Threads, or the cache, wait for ever for a lock of one that got no memory.
        spec.compiler.usethread = False
        mujoco.mj_setCacheCapacity(mujoco.mj_getCache(), 0)
        if hull_corners:
            for mesh in spec.meshes:
                mesh.maxhullvert = hull_corners
        if root.tag == "robot":
            add_what_moves(spec, root, base, passive)
        elif passive:
            raise ArgumentError(
                "passive: joints of a URDF may be passive. In an MJCF model take their actuators out."
            )
        return spec.compile()


def _assemble(main: str, source: Source) -> tuple[Element, Assets]:
    """Return (one checked XML tree without includes, its assets by the names the tree gives them)."""
    root, settings = _read_tree(main, source)
    assets = attach_files(source, main, root, settings)
    check_cells(root, assets)
    return root, assets


def _read_tree(main: str, source: Source) -> tuple[Element, dict[str, str]]:
    """Return (one checked XML tree without includes, what its <compiler> elements set)."""
    content = source.take(main)
    if content is None:
        refuse(main, "", "no such file. Check the path")
    root = parse(source, main, content)
    expand(source, root, (main,), {main})
    settings = _take_settings(root)
    if root.tag == "robot":
        _trim_urdf(root, settings)
    check_elements(root)
    return root, settings


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
