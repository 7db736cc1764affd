"""Nodes, tetrahedra and named groups of tetrahedra of a Gmsh file, and nothing else, in MSH ASCII 2.2 and 4.1.

$PhysicalNames  count, then "dimension tag name" lines
$Entities       4.1: counts of points, curves, surfaces and volumes; each volume: tag, six numbers, count and tags of its groups
$Nodes     2.2: count, then "tag x y z" lines
           4.1: blocks, count, least tag, most; each block: dimension, entity, parametric, count; its tags; its "x y z"
$Elements  2.2: count, then "tag type count labels... nodes..." lines, the first label a group's tag
           4.1: the same heads; each block: dimension, entity, type, count; its "tag nodes..." lines
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from neuroanimator.errors import BadFileError
from neuroanimator.files.names import PART_PATTERN
from neuroanimator.files.numbers import whole_in
from neuroanimator.files.text_lines import text_lines
from neuroanimator.physics.soft.mesh import Mesh, coordinates, refuse_size
from neuroanimator.text import quoted

TETRAHEDRON = 4
"""Gmsh's number of the four-node tetrahedron."""

CURVED_TETRAHEDRA = (11, 29, 30)
"""Gmsh's numbers of tetrahedra with nodes on their edges."""

NO_GROUP = ""
"""Name of the group of tetrahedra in none."""

MAX_GROUPS = 10_000
"""Maximum number of named groups in a file."""

MAX_ELEMENTS = 2_000_000
"""Maximum number of elements of all kinds in a file."""

VERSIONS = ("2.2", "4.1")
"""Versions of the format that are read."""


class _Lines:
    """The lines of a file, and the position of the reader."""

    def __init__(self, name: str, content: bytes):
        self.name = name
        try:
            self._lines = [line for _, line in text_lines(content, "replace")]
        except ValueError as error:
            raise BadFileError(f"{name}: {error}. Save it again.") from error
        self._next = 0
        self._wanted = ""
        self._sections: dict[str, int] = {}
        for number, line in enumerate(self._lines, start=1):
            if line.lstrip().startswith("$"):
                self._sections.setdefault(line.strip(), number)

    @property
    def number(self) -> int:
        """Number of the line that was read last, from 1."""
        return self._next

    def section(self, title: str) -> None:
        """Go to the line after `$title`."""
        if not self.has_section(title):
            raise BadFileError(f"{self.name}: no ${title}. Save it again as Gmsh MSH, ASCII.")

    def has_section(self, title: str) -> bool:
        """Go to the line after `$title`; return False if there is none."""
        self._next = self._sections.get(f"${title}", self._next)
        return f"${title}" in self._sections

    def words(self, least: int, wanted: str = "numbers") -> list[str]:
        """Return the words of the next line, at least `least` of them; `wanted` says what they are."""
        self._wanted = wanted
        words: list[str] = []
        if self._next < len(self._lines):
            words = self._lines[self._next].split()
        self._next += 1
        if len(words) < least:
            raise self.fault(f"at least {least} {wanted}")
        return words

    def wholes(self, least: int) -> list[int]:
        """Return the integers of the next line."""
        return [whole_in(word) for word in self.words(least, "whole numbers")]

    def fault(self, wanted: str = "") -> BadFileError:
        """Return the error about the line that was read last: it is not what is, or was, `wanted`."""
        text = wanted or self._wanted
        return BadFileError(f"{self.name}: line {self._next}: wanted {text}. Save it again.")


def read_msh(name: str, content: bytes) -> Mesh:
    """Return the nodes and tetrahedra in the file's unit and axes, without unused nodes.

    Raises BadFileError, naming the file and the line, for any other content.
    """
    lines = _Lines(name, content)
    try:
        return _read(name, lines)
    except (ValueError, IndexError) as error:  # a word that is no number, or missing
        raise lines.fault() from error


def _read(name: str, lines: _Lines) -> Mesh:
    lines.section("MeshFormat")
    version, kind = lines.words(3)[:2]
    if version not in VERSIONS or kind != "0":
        raise BadFileError(
            f"{name}: wanted Gmsh MSH 2.2 or 4.1 in ASCII, got version {quoted(version)}, kind {quoted(kind)}. "
            "Save it again: gmsh -3 -format msh41 solid.geo"
        )
    is_old = version == "2.2"
    lines.section("Nodes")
    places, positions = _nodes(lines, is_old)
    names = _group_names(lines)
    of_volumes = _groups_of_volumes(lines)
    lines.section("Elements")
    tetrahedra: list[list[int]] = []
    numbers: list[int] = []
    members: list[str] = []
    for element, label, corners in _elements(lines, is_old):
        if element in CURVED_TETRAHEDRA:
            raise BadFileError(
                f"{name}: tetrahedra of second order. Save it with straight ones: gmsh -3 -order 1"
            )
        if element == TETRAHEDRON:
            if len(corners) != 4 or not places.keys() >= set(corners):
                raise lines.fault("four nodes of the file")
            tetrahedra.append([places[tag] for tag in corners])
            numbers.append(lines.number)
            group = label if is_old else of_volumes.get(label, 0)
            members.append(names.get(group, NO_GROUP))
    if not tetrahedra:
        raise BadFileError(
            f"{name}: no tetrahedra. Mesh the inside of the body, not its surface alone: gmsh -3"
        )
    mesh = Mesh(
        np.array(positions), np.array(tetrahedra), name, np.array(list(places)), np.array(numbers)
    )
    corners = np.sort(np.array(tetrahedra), axis=1)
    _, first, counts = np.unique(corners, axis=0, return_index=True, return_counts=True)
    if (counts > 1).any():
        doubled = numbers[int(first[counts > 1].min())]
        raise BadFileError(
            f"{name}: line {doubled}: a tetrahedron that comes again, as one in two physical groups does. Leave it to one."
        )
    groups, ranks = np.unique([NO_GROUP, *members], return_inverse=True)
    grouped = mesh._replace(groups=tuple(groups[1:].tolist()), members=ranks[1:] - 1)
    return grouped.only(np.arange(len(tetrahedra)))


def _group_names(lines: _Lines) -> dict[int, str]:
    """Return the name of each group of volumes by its tag; groups with names that no muscle may have are left out."""
    if not lines.has_section("PhysicalNames"):
        return {}
    (count,) = lines.wholes(1)[:1]
    if not 0 <= count <= MAX_GROUPS:
        raise lines.fault(f"0 to {MAX_GROUPS} groups")
    names = {}
    for _ in range(count):
        dimension, tag, *words = lines.words(3)
        if dimension == "3":
            names[whole_in(tag)] = " ".join(words).strip('"')
    return {tag: name for tag, name in names.items() if re.fullmatch(PART_PATTERN, name)}


def _groups_of_volumes(lines: _Lines) -> dict[int, int]:
    """Return the tag of the group each volume of version 4.1 is in; refuse a volume in two."""
    if not lines.has_section("Entities"):
        return {}
    counts = lines.wholes(4)[:4]
    if not all(0 <= count <= MAX_ELEMENTS for count in counts):
        raise lines.fault(f"0 to {MAX_ELEMENTS:,} entities")
    for _ in range(sum(counts[:3])):
        lines.words(1)
    groups = {}
    for _ in range(counts[3]):
        tag, *rest = lines.words(8)
        count = whole_in(rest[6])
        if count > 1:
            raise lines.fault("a volume in at most one physical group")
        if count == 1:
            groups[whole_in(tag)] = whole_in(rest[7])
    return groups


def _nodes(lines: _Lines, is_old: bool) -> tuple[dict[int, int], list[list[float]]]:
    """Return (the index of each node by its tag, positions)."""
    count, blocks = _head(lines, is_old)
    if count < 1:
        raise lines.fault("a number of nodes above 0")
    refuse_size(lines.name, count)
    tags: list[int] = []
    positions: list[list[float]] = []
    if is_old:
        for _ in range(count):
            tag, *rest = lines.words(4, "three coordinates")
            tags.append(whole_in(tag))
            positions.append(coordinates(rest))
    for _ in range(blocks):
        own = lines.wholes(4)[3]
        if not 0 <= own <= count - len(tags):
            raise lines.fault("no more nodes than the section says")
        tags += [lines.wholes(1)[0] for _ in range(own)]
        positions += [coordinates(lines.words(3, "three coordinates")) for _ in range(own)]
    places = {tag: place for place, tag in enumerate(tags)}
    if len(places) < len(tags) or min(tags, default=0) < 0:
        raise BadFileError(
            f"{lines.name}: two nodes have the same number, or a number is negative. Save it again."
        )
    return places, positions


def _head(lines: _Lines, is_old: bool) -> tuple[int, int]:
    """Return (the number of nodes or elements in a section, its number of blocks)."""
    if is_old:
        return lines.wholes(1)[0], 0
    blocks, count = lines.wholes(4)[:2]
    return count, blocks


def _elements(lines: _Lines, is_old: bool) -> Iterator[tuple[int, int, list[int]]]:
    """Yield the kind, the label and the nodes of each element: a label is a group's tag, or in 4.1 a volume's."""
    left, blocks = _head(lines, is_old)
    if not 0 <= left <= MAX_ELEMENTS:
        raise lines.fault(f"0 to {MAX_ELEMENTS:,} elements")
    for _ in range(left if is_old else 0):
        _, kind, labels, *rest = lines.wholes(3)
        yield kind, rest[0] if labels > 0 and rest else 0, rest[max(labels, 0) :]
    for _ in range(blocks):
        _, entity, kind, own = lines.wholes(4)[:4]
        if not 0 <= own <= left:
            raise lines.fault("no more elements than the section says")
        left -= own
        for _ in range(own):
            yield kind, entity, lines.wholes(1)[1:]
