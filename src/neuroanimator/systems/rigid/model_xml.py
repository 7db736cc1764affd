"""The XML of a model and the files it names: found inside one folder only, and joined into one tree."""

from __future__ import annotations

import posixpath
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from shlex import quote
from typing import Any, NamedTuple, NoReturn, cast
from xml.parsers import expat

from neuroanimator.errors import BadFileError

XML_LIMIT = 2 * 2**20
"""No XML file of a model may be larger [bytes]."""

INCLUDE_LIMIT = 16
"""An include may lie so deep in other includes."""

DEPTH_LIMIT = 100
"""An element may lie so deep in other elements."""

ELEMENT_LIMIT = 10_000
"""Maximum number of elements in a model's files, counted while they are read: each takes far more memory than its text."""

ATTRIBUTE_LIMIT = 100
"""Maximum number of an element's attributes: MuJoCo compares each with all the others, 49 s for 150,000."""

MAX_UP = 4
"""Number of folders upwards, itself among them, in which a missing file is looked for, to tell where it is."""

PATH_PARTS = 12
"""Maximum number of last parts tried of the path of a URDF's mesh."""

MAX_TAG = 40
"""Maximum number of characters of an element's tag shown in an error."""

MAX_SHOWN = 80
"""Maximum number of characters of an attribute shown in an error."""


class Element(ET.Element):
    """An XML element that knows where it stands."""

    origin: tuple[str, int] = ("", 0)
    """The file the element stands in, and its line there."""

    def children(self) -> list[Element]:
        """Return the elements directly inside."""
        return cast("list[Element]", list(self))

    def descendants(self) -> list[Element]:
        """Return itself and every element inside, in document order."""
        return cast("list[Element]", list(self.iter()))

    def file_attributes(self) -> list[str]:
        """Return the attributes that name files: `file`, URDF's `filename`, a sky's `fileleft` and so on."""
        return [name for name in self.attrib if name.startswith("file")]


class Limits(NamedTuple):
    """How much of files a model may have."""

    file: int
    """The largest file [bytes]."""
    total: int
    """All files together [bytes]."""
    files: int
    """The number of files."""


CARRIED = Limits(2 * 2**20, 4 * 2**20, 200)
"""Of a model that travels with an emulator, or as it is."""

ON_DISK = Limits(64 * 2**20, 256 * 2**20, 2000)
"""Of a model that a user names, and that is made light before it travels."""


class TooLargeError(BadFileError):
    """A model's files are beyond the limits."""


def refuse(file: str, where: str, fault: str) -> NoReturn:
    """Raise BadFileError: `file: where: fault.`"""
    if not where:
        raise BadFileError(f"{file}: {fault}.")
    raise BadFileError(f"{file}: {where}: {fault}.")


def refuse_at(element: Element, attribute: str, fault: str) -> NoReturn:
    """Raise BadFileError naming the element, its line, and `attribute` where it has it."""
    where = named(element)
    if attribute in element.attrib:
        where += f" {attribute}={_shown(element.attrib[attribute])}"
    file, line = element.origin
    refuse(file, where, f"{fault} (line {line})")


def named(element: Element) -> str:
    """Return what an element is, and its name if it has one."""
    tag = element.tag[:MAX_TAG]
    if "name" not in element.attrib:
        return tag
    return f"{tag} {_shown(element.attrib['name'])}"


def _shown(text: str) -> str:
    if len(text) > MAX_SHOWN:
        text = f"{text[:MAX_SHOWN]}..."
    return repr(text)


@dataclass
class Source:
    """Where a model's files come from; takes each once, and nothing beyond the limits."""

    load: Callable[[str], bytes | None]
    """Returns the bytes of a file by its path in the model's folder, or None if there is no such file."""

    taken: dict[str, bytes] = field(default_factory=dict)
    """The bytes of every file read so far, by its path."""

    elements: int = 0
    """The number of elements read so far, in all files."""

    limits: Limits = CARRIED

    where_outside: Callable[[str], str] = lambda _: ""
    """Returns the folder that holds both the model and a path outside its tree, `../a.stl`, as words; empty if none may."""

    def take(self, name: str) -> bytes | None:
        """Return the bytes of `name`, or None if there is no such file; BadFileError beyond the limits."""
        content = self.taken.get(name)
        if content is None:
            content = self.load(name)
        if content is None:
            return None
        self.taken[name] = content
        limits = self.limits
        if len(content) > limits.file:
            raise TooLargeError(
                f"{name}: larger than {limits.file:,} bytes. Make the file smaller."
            )
        total = sum(len(file) for file in self.taken.values())
        if len(self.taken) > limits.files or total > limits.total:
            raise TooLargeError(
                f"{name}: the model has more than {limits.files:,} files or {limits.total:,} bytes. Make it smaller."
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
    """Return what to do about a file that is not in the model's tree but may be in one of `folders`."""
    for folder in folders:
        if folder:
            return f"If the model may read files there, say 'new --tree {quote(folder)}'"
    return "Put the file beside the model"


def _candidates(
    element: Element, attribute: str, folders: list[str]
) -> tuple[list[str], list[str]]:
    """Return the paths where a file may be, inside the model's tree and outside of it (`../a.stl`), each once.

    `package://name/` counts as the tree. A URDF's folder may be any part of its package, so that a path may begin too
    high up: its ends are tried, too. Paths that are absolute, or no plain ones, are refused.
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
    """Return the root element; refuses document types, which can define entities that explode."""
    if len(content) > XML_LIMIT:
        refuse(name, "", f"larger than {XML_LIMIT:,} bytes. Write a smaller model")
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
        if len(attributes) > ATTRIBUTE_LIMIT:
            refuse(
                name,
                tag[:MAX_TAG],
                f"more than {ATTRIBUTE_LIMIT} attributes. Write a smaller model",
            )
        if source.elements > ELEMENT_LIMIT:
            refuse(name, "", f"more than {ELEMENT_LIMIT:,} elements. Write a smaller model")
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


def expand(source: Source, element: Element, chain: tuple[str, ...], seen: set[str]) -> None:
    """Replace each include inside `element` by the contents of its file.

    `chain` holds the files around `element`, outermost first; `seen` every file included so far.
    """
    children: list[Element] = []
    for child in element.children():
        if child.tag.lower() == "include":
            children.extend(_included(source, child, chain, seen))
        else:
            expand(source, child, chain, seen)
            children.append(child)
    element[:] = children


def _included(
    source: Source, include: Element, chain: tuple[str, ...], seen: set[str]
) -> list[Element]:
    if "file" not in include.attrib:
        refuse_at(include, "", "no file attribute. Name the file to include")
    folders = [str(PurePosixPath(file).parent) for file in (chain[0], chain[-1])]
    name, content = source.find(include, "file", folders)
    if name in seen or len(chain) > INCLUDE_LIMIT:
        refuse_at(
            include,
            "file",
            f"included twice, in a circle, or over {INCLUDE_LIMIT} deep. Include it once",
        )
    seen.add(name)
    root = parse(source, name, content)
    expand(source, root, (*chain, name), seen)
    return root.children()


def attach_files(
    source: Source, main: str, root: Element, settings: dict[str, str]
) -> dict[str, bytes]:
    """Return the assets by names no two files share, and point the attributes of `root` to those names.

    Paths begin at the folder of the file `main`, or at that of the file the attribute stands in.
    """
    assets: dict[str, bytes] = {}
    for element in root.descendants():
        for attribute in element.file_attributes():
            folders = _folders(element, attribute, settings, main)
            name, content = source.find(element, attribute, folders)
            if attribute == "file" and "name" not in element.attrib:
                element.set("name", PurePosixPath(name).stem)
            number = list(source.taken).index(name)  # two folders may hold files of one name
            asset = f"{number}-{PurePosixPath(name).name}"
            element.set(attribute, asset)
            assets[asset] = content
    return assets


def _folders(element: Element, attribute: str, settings: dict[str, str], main: str) -> list[str]:
    """Return where the file an attribute names may be, after removing the path MuJoCo would strip from it."""
    if settings.get("strippath") == "true" and attribute != "filename":
        element.set(attribute, re.split(r"[/\\]", element.attrib[attribute])[-1])
    setting = "meshdir"
    if element.tag == "texture":
        setting = "texturedir"
    folder = settings.get(setting, settings.get("assetdir", ""))
    beside_main = PurePosixPath(main).parent
    beside_file = PurePosixPath(element.origin[0]).parent
    # Older models say it the other way round.
    folders = [beside_main / folder, beside_file / folder, PurePosixPath(folder) / beside_file]
    if attribute == "filename":
        folders.append(PurePosixPath(folder))  # a URDF's paths may begin at its package
    return [str(each) for each in folders]
