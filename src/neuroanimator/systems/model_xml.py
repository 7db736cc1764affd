"""The XML files of a model, as far as they name other files; MuJoCo reads the rest."""

from __future__ import annotations

import posixpath
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import PurePosixPath
from shlex import quote
from typing import Any, NoReturn, cast
from xml.parsers import expat

from neuroanimator.errors import BadFileError

ELEMENT_LIMIT = 10_000
"""Maximum number of elements in a model's files, counted during reading: each takes far more memory than its text."""

ATTRIBUTE_LIMIT = 100
"""Maximum number of an element's attributes: MuJoCo compares all pairs, which takes 49 s for 150,000."""

DEPTH_LIMIT = 100
"""Maximum depth of nested elements: they are written recursively."""

NODE_LIMIT = 10_000
"""Maximum number of nodes of a model's soft bodies: a step of so large a body takes tens of milliseconds."""

MAX_FILE = 64 * 2**20
"""Maximum size of a model's file [bytes]."""

MAX_FILES = 2000
"""Maximum number of a model's files."""

MAX_TOTAL = 256 * 2**20
"""Maximum size of all files of a model together [bytes]."""

MAX_UP = 4
"""Number of folders upwards, including its own, in which a missing file is searched for, to name its place."""

PATH_PARTS = 12
"""Maximum number of trailing parts of the path of a URDF's mesh that are tried."""

MAX_DIGITS = 10
"""Number of digits beyond any count of nodes."""

MAX_TAG = 40
"""Maximum number of characters of an element's tag shown in an error."""

MAX_SHOWN = 80
"""Maximum number of characters of an attribute shown in an error."""

MACRO = "xacro:"
"""Prefix of the tags of xacro, the language in which most URDFs are written."""

COLOR_SIZE = 4
"""Number of values of a colour: red, green, blue and opacity."""

URDF_PARTS = {"link", "joint", "material", "mujoco"}
"""Elements of a URDF that MuJoCo reads; the rest, such as <gazebo>, is dropped."""

FOLDER_SETTINGS = ("assetdir", "meshdir", "texturedir", "strippath")
"""Attributes of <compiler> that define where files lie."""

MODEL = "model"
"""Tag of a model that others attach."""

REFUSED = {
    "composite": "composites are not supported. Write a rope, a cloth or a solid as a <flexcomp>",
    "plugin": "plugins run foreign code. Remove it",
}
"""Elements that are not supported, and why."""

Files = dict[str, bytes]
"""Contents of files, by name."""


class Element(ET.Element):
    """An XML element with its place in a file."""

    origin: tuple[str, int] = ("", 0)
    """File and line of the element."""

    def children(self) -> list[Element]:
        """Return the elements directly inside."""
        return cast("list[Element]", list(self))

    def descendants(self) -> list[Element]:
        """Return itself and every element inside, in document order."""
        return cast("list[Element]", list(self.iter()))

    def file_attributes(self) -> list[str]:
        """Return the attributes that name files: `file`, URDF's `filename`, a skybox's `fileleft` and so on."""
        return [name for name in self.attrib if name.startswith("file")]


def refuse(file: str, where: str, fault: str) -> NoReturn:
    """Raise BadFileError: `file: where: fault.`"""
    if not where:
        raise BadFileError(f"{file}: {fault}.")
    raise BadFileError(f"{file}: {where}: {fault}.")


def refuse_at(element: Element, attribute: str, fault: str) -> NoReturn:
    """Raise BadFileError naming the element, its line, and its `attribute` if it has it."""
    where = element.tag[:MAX_TAG]
    if "name" in element.attrib:
        where += f" {_shown(element.attrib['name'])}"
    if attribute in element.attrib:
        where += f" {attribute}={_shown(element.attrib[attribute])}"
    file, line = element.origin
    refuse(file, where, f"{fault} (line {line})")


def _shown(text: str) -> str:
    if len(text) > MAX_SHOWN:
        text = f"{text[:MAX_SHOWN]}..."
    return repr(text)


@dataclass
class Source:
    """The source of a model's files; each is read once, and nothing beyond the limits."""

    load: Callable[[str], bytes | None]
    """Returns the bytes of a file by its path in the model's folder, or None if there is no such file."""

    taken: Files = field(default_factory=dict)
    """Bytes of every file read so far, by path."""

    elements: int = 0
    """Number of elements read so far, in all files."""

    where_outside: Callable[[str], str] = lambda _: ""
    """Returns the folder that holds both the model and a path outside its tree, such as `../a.stl`; empty if none may."""

    def take(self, name: str) -> bytes | None:
        """Return the bytes of `name`, or None if there is no such file; BadFileError beyond the limits."""
        content = self.taken.get(name)
        if content is None:
            content = self.load(name)
        if content is None:
            return None
        self.taken[name] = content
        if len(content) > MAX_FILE:
            refuse(name, "", f"larger than {MAX_FILE:,} bytes. Make the file smaller")
        total = sum(len(file) for file in self.taken.values())
        if len(self.taken) > MAX_FILES or total > MAX_TOTAL:
            refuse(
                name,
                "",
                f"the model has more than {MAX_FILES:,} files or {MAX_TOTAL:,} bytes. Make it smaller",
            )
        return content

    def find(self, element: Element, attribute: str, folders: list[str]) -> tuple[str, bytes]:
        """Return (name, bytes) of the file an attribute names, in the first of `folders` that has it."""
        inside, outside = _candidates(element, attribute, folders)
        for name in inside:
            content = self.take(name)
            if content is not None:
                return name, content
        if outside:
            advice = _advice([self.where_outside(name) for name in outside])
            culprit = ""
            if not posixpath.normpath(element.attrib[attribute]).startswith(".."):
                culprit = f" by {_shown(folders[0])}"
            refuse_at(element, attribute, f"leaves the model's folder{culprit}. {advice}")
        above = ["../" * up + name for up in range(1, MAX_UP) for name in inside]
        advice = _advice([self.where_outside(name) for name in above])
        refuse_at(element, attribute, f"no such file. {advice}")


def _advice(folders: list[str]) -> str:
    """Return advice on a file that is not in the model's tree but may be in one of `folders`."""
    for folder in folders:
        if folder:
            return f"If the model may read files there, use 'new --tree {quote(folder)}'"
    return "Put the file beside the model"


def _candidates(
    element: Element, attribute: str, folders: list[str]
) -> tuple[list[str], list[str]]:
    """Return the possible paths of a file, inside the model's tree and outside it (`../a.stl`), without duplicates.

    `package://name/` counts as the tree. A URDF may lie anywhere in its package, so that a path may begin too high up: its
    ends are tried, too. Absolute and unusual paths are refused.
    """
    written = element.attrib[attribute].replace("\\", "/")
    text = written
    paths = [text]
    if attribute == "filename":
        text = re.sub("^(package|model)://[^/]*/", "", text)
        named = re.sub("^(package|model):/*", "", written)  # its name may be a folder's
        parts = [part for part in text.split("/") if part != ".."][-PATH_PARTS:]
        paths = [text, named, *("/".join(parts[first:]) for first in range(len(parts)))]
    for part in (text, *folders):
        if re.search(r"^/|[:\0]", part):
            culprit = ""
            if part != text:
                culprit = f" by {_shown(part)}"
            refuse_at(
                element,
                attribute,
                f"leaves the model's folder{culprit}. Put the file beside the model",
            )
    inside: list[str] = []
    outside: list[str] = []
    for path in paths:
        for folder in folders:
            name = posixpath.normpath(PurePosixPath(folder, path).as_posix())
            if name == ".." or name.startswith("../"):
                outside.append(name)
            else:
                inside.append(name)
    return list(dict.fromkeys(inside)), list(dict.fromkeys(outside))


def parse(source: Source, name: str, content: bytes) -> Element:
    """Return the root element; refuses document types, which can define exploding entities."""
    parser = expat.ParserCreate()
    open_elements: list[Element] = []
    roots: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes)
        element.origin = (name, parser.CurrentLineNumber)
        if open_elements:
            open_elements[-1].append(element)
        else:
            roots.append(element)
        open_elements.append(element)
        source.elements += 1
        if source.elements > ELEMENT_LIMIT:
            refuse(name, "", f"more than {ELEMENT_LIMIT:,} elements. Write a smaller model")
        if len(attributes) > ATTRIBUTE_LIMIT:
            refuse_at(element, "", f"more than {ATTRIBUTE_LIMIT} attributes. Write a smaller model")
        if len(open_elements) > DEPTH_LIMIT:
            refuse_at(element, "", f"more than {DEPTH_LIMIT} elements deep. Write a flatter model")

    def end(_tag: str) -> None:
        open_elements.pop()

    def doctype(tag: str, *_: Any) -> None:
        refuse(name, f"DOCTYPE {_shown(tag)}", "document types and entities are refused. Remove it")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise BadFileError(f"{name}: not XML: {error}. Check the file.") from error
    return roots[0]


@dataclass(frozen=True)
class Documents:
    """The XML of a model and the files it names, as given to MuJoCo: from memory, by unique names."""

    main: str
    """Text of the model's main file."""
    is_urdf: bool
    includes: Files
    """The other XML files, by their new names in the XML."""
    assets: Files
    """The meshes and pictures, by their new names."""


def gather(main: str, source: Source) -> Documents:
    """Return the model in the file `main` and every file it names, all from `source`.

    Raises BadFileError naming the file and the element: a path out of the model's folder, a missing file, a document
    type, a model that attaches itself, or more than the limits.
    """
    content = source.take(main)
    if content is None:
        refuse(main, "", "no such file. Check the path")
    root = parse(source, main, content)
    includes: Files = {}
    assets: Files = {}
    attached: dict[str, list[str]] = {}
    waiting = [(main, root)]
    while waiting:
        name, of_model = waiting.pop()
        if name in attached:
            continue
        found, files = _gather_model(source, name, of_model, includes)
        assets |= files
        attached[name] = list(found)
        waiting += found.items()
    try:
        TopologicalSorter(attached).prepare()
    except CycleError as error:
        circle = " attaches ".join(error.args[1])
        refuse(main, "model", f"{circle}: no model may attach itself. Remove one of them")
    text = includes[_key(source, main, main)].decode()
    return Documents(text, root.tag == "robot", includes, assets)


def _gather_model(
    source: Source, main: str, root: Element, texts: Files
) -> tuple[dict[str, Element], Files]:
    """Return the models that the model in `main` attaches, and the meshes and pictures it names.

    Its XML files, with these under new names, are put into `texts`.
    """
    roots = {main: root}
    waiting = [main]
    while waiting:
        name = waiting.pop()
        for included, text in _includes(source, roots[name], main):
            if included not in roots:
                roots[included] = parse(source, included, text)
                waiting.append(included)
    settings = _take_settings(list(roots.values()))
    if root.tag == "robot":
        _trim_urdf(root, settings)
    attached: dict[str, Element] = {}
    files: Files = {}
    for name, of_file in roots.items():
        models, assets = _attach_files(source, main, of_file, settings)
        for model, text in models.items():
            if model not in attached:
                attached[model] = parse(source, model, text)
        files |= assets
        texts[_key(source, main, name)] = ET.tostring(of_file, encoding="utf-8")
    return attached, files


def _key(source: Source, *names: str) -> str:
    """Return a unique name for MuJoCo of a file, or of one in a model: two folders may hold files of one name."""
    order = list(source.taken)
    numbers = [str(order.index(name)) for name in names]
    return "-".join([*numbers, PurePosixPath(names[-1]).name])


def _includes(source: Source, root: Element, main: str) -> list[tuple[str, bytes]]:
    """Return (name, bytes) of each included XML file, and point the include to its new name."""
    found = []
    for element in root.descendants():
        if element.tag != "include":
            continue
        if "file" not in element.attrib:
            refuse_at(element, "", "no file attribute. Name the file to include")
        folders = [str(PurePosixPath(file).parent) for file in (main, element.origin[0])]
        name, content = source.find(element, "file", folders)
        element.set("file", _key(source, main, name))
        found.append((name, content))
    return found


def _take_settings(roots: list[Element]) -> dict[str, str]:
    """Return the settings of the <compiler> elements; those of paths are removed, as `_attach_files` applies them."""
    settings: dict[str, str] = {}
    for root in roots:
        for compiler in root.iter("compiler"):
            settings |= compiler.attrib
            for name in FOLDER_SETTINGS:
                compiler.attrib.pop(name, None)
    return settings


def _attach_files(
    source: Source, main: str, root: Element, settings: dict[str, str]
) -> tuple[Files, Files]:
    """Return the models, and the meshes and pictures, named in the XML, and point its attributes to their new names.

    Models have their paths as names. Paths begin at the folder of the file `main`, or at that of the attribute's file.
    """
    models: Files = {}
    files: Files = {}
    for element in root.descendants():
        if element.tag == "include":
            continue
        if element.tag in REFUSED:
            refuse_at(element, "", REFUSED[element.tag])
        if element.tag == "flexcomp":
            _check_count(element)
        for attribute in element.file_attributes():
            folders = _folders(element, attribute, settings, main)
            name, content = source.find(element, attribute, folders)
            if element.tag == MODEL:
                models[name] = content
                element.set(attribute, _key(source, name, name))
                continue
            if attribute == "file" and "name" not in element.attrib:
                element.set("name", PurePosixPath(name).stem)
            element.set(attribute, _key(source, name))
            files[_key(source, name)] = content
    return models, files


def _check_count(element: Element) -> None:
    """Refuse a grid of too many nodes before MuJoCo makes them; MuJoCo itself refuses invalid numbers."""
    nodes = 1
    for text in element.get("count", "").split():
        nodes *= int(text) if text.isascii() and text.isdigit() and len(text) < MAX_DIGITS else 1
    if nodes > NODE_LIMIT:
        refuse_at(
            element,
            "count",
            f"{nodes:,} nodes; at most {NODE_LIMIT:,} are supported. Make it of fewer",
        )


def _folders(element: Element, attribute: str, settings: dict[str, str], main: str) -> list[str]:
    """Return the possible folders of the file an attribute names, after removing the path MuJoCo would strip from it."""
    if settings.get("strippath") == "true" and attribute != "filename":
        element.set(attribute, re.split(r"[/\\]", element.attrib[attribute])[-1])
    setting = "meshdir"
    if element.tag == "texture":
        setting = "texturedir"
    folder = settings.get(setting, settings.get("assetdir", ""))
    if element.tag == MODEL:
        folder = ""
    beside_main = PurePosixPath(main).parent
    beside_file = PurePosixPath(element.origin[0]).parent
    # Older models have the opposite order.
    folders = [beside_main / folder, beside_file / folder, PurePosixPath(folder) / beside_file]
    if attribute == "filename":
        folders.append(PurePosixPath(folder))  # a URDF's paths may begin at its package
    return [str(each) for each in folders]


def _trim_urdf(root: Element, settings: dict[str, str]) -> None:
    """Remove the parts of a URDF that MuJoCo does not read, so that their files are not needed; xacro macros are refused."""
    for element in root.descendants():
        if element.tag.startswith(MACRO):
            refuse_at(
                element,
                "",
                "xacro's macros are not expanded. Run `xacro` on the file, and use its output",
            )
    root[:] = [child for child in root if child.tag in URDF_PARTS]
    for texture in root.iter("texture"):
        texture.attrib.clear()
    for material in root.descendants():
        # A colour of three or five numbers is no reason to refuse a robot.
        if material.tag == "material":
            material[:] = [child for child in material if _is_color(child)]
    if settings.get("discardvisual", "true") == "true":
        for visual in root.iter("visual"):
            visual[:] = [child for child in visual if child.tag != "geometry"]


def _is_color(element: ET.Element) -> bool:
    """Return whether an element of a material is anything other than a colour without exactly four numbers."""
    return element.tag != "color" or len(element.get("rgba", "").split()) == COLOR_SIZE
