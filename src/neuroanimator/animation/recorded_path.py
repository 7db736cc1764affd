"""Paths recorded elsewhere, such as a character's clip: a CSV table of positions, or a node of a GLB file."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.glb_motion import Track, node_motion
from neuroanimator.animation.glb_rig import Rig
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.atomic import one_line, read_bounded
from neuroanimator.files.clock import resolution_of, straightened
from neuroanimator.files.glb import Glb, read_glb
from neuroanimator.files.number_table import read_header, read_numbers
from neuroanimator.state.columns import TIME, time_column, without_brackets
from neuroanimator.state.mover_poses import Mover
from neuroanimator.state.rotation import continuous, facing
from neuroanimator.state.units import converted_unit
from neuroanimator.text import did_you_mean, listed, quoted

MAX_TABLE = 64 * 2**20
"""Maximum size of a table [bytes]."""

MAX_SECONDS = 3600.0
"""Maximum duration of a path [s]: an hour."""

MAX_COORDINATE = 1e6
"""Maximum coordinate [m], angle [rad] or time [s]."""

UNITS = {"s": "seconds", "m": "metres", "rad": "radians", "1": "plain numbers"}
"""Units of columns, where a header gives any, and their names in messages."""

MAX_GAP = 10.0
"""Ratio of the time between two rows to the usual time above which rows are missing."""

SHORTEST = 1e-6
"""Length below which a quaternion gives no rotation."""

SOURCE = re.compile(r"(?P<file>.*?\.(?P<kind>csv|glb))(?::(?P<part>.+))?", re.IGNORECASE)
"""Pattern of a file, with a part of it after a colon: FILE.csv, FILE.csv:PART or FILE.glb:NODE."""


@dataclass(frozen=True, eq=False)
class RecordedPath:
    """Positions of something over time, and its orientation."""

    name: str
    """Its origin, as messages state it."""
    times: Float[np.ndarray, " T"]
    """Increasing times [s]."""
    positions: Float[np.ndarray, "T 3"]
    """Positions [m], Z up."""
    orientations: Float[np.ndarray, "T 4"] | None = None
    """Unit quaternions wxyz, of which the sign does not matter; None if not known."""

    def __post_init__(self) -> None:
        columns = [self.times, *self.positions.T]
        if self.orientations is not None:
            columns += list(self.orientations.T)
        for column in columns:
            if not (np.abs(column) <= MAX_COORDINATE).all():  # false for NaN, too
                raise BadFileError(
                    f"{self.name}: a number that is not finite or above {MAX_COORDINATE:g}. Remove such rows."
                )
        if len(self.times) < 2:
            raise BadFileError(f"{self.name}: wanted at least two times, got {len(self.times)}.")
        backwards = np.flatnonzero(np.diff(self.times) <= 0)
        if len(backwards):
            before, after = self.times[backwards[0] : backwards[0] + 2]
            raise BadFileError(
                f"{self.name}: wanted rising times, got {after:g} s after {before:g} s. Sort the rows, and remove duplicates."
            )
        if self.times[-1] - self.times[0] > MAX_SECONDS:
            raise BadFileError(
                f"{self.name}: {self.times[-1] - self.times[0]:g} s; wanted at most {MAX_SECONDS:g}. Cut it into parts."
            )

    def at(
        self, times: Float[np.ndarray, " F"]
    ) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, "F 4"] | None]:
        """Return positions [m] and orientations at `times` [s]; between the rows it moves and turns evenly."""
        positions = Track(self.times, self.positions, "LINEAR", is_rotation=False).at(times)
        if self.orientations is None:
            return positions, None
        turned = np.roll(self.orientations, -1, axis=1)
        turned = Track(self.times, turned, "LINEAR", is_rotation=True).at(times)
        return positions, np.roll(turned, 1, axis=1)

    def poses(
        self, mover: Mover, rest: Float[np.ndarray, " D"], times: Float[np.ndarray, " F"]
    ) -> Float[np.ndarray, "F D"]:
        """Return the poses of a `mover`, at `rest` elsewhere, that follows the path at `times` [s], as far as it turns."""
        positions, orientations = self.at(times)
        poses = np.repeat(rest[None], len(times), axis=0)
        poses[:, :3] = positions
        if orientations is not None and mover.turns_freely:
            poses[:, 3:] = continuous(orientations)
        elif orientations is not None and mover.turns:
            poses[:, 3] = headings_of(orientations)
        return poses


def headings_of(orientations: Float[np.ndarray, "T 4"]) -> Float[np.ndarray, " T"]:
    """Return the angles by which quaternions turn about Z [rad], whatever their tilt, without jumps."""
    return np.unwrap(2 * np.arctan2(orientations[:, 3], orientations[:, 0]))


def read_path(source: str | Path) -> RecordedPath:
    """Return the path in a file: `walk.csv`, `walk.csv:torso` or `walk.glb:Spine2`.

    A CSV table has columns `time` [s], `x`, `y`, `z` [m], and optionally `heading` [rad] or a quaternion `qw`, `qx`,
    `qy`, `qz`; other units are named, as in `x mm`. A name after a colon picks another position: the columns `torso[0]`,
    `torso[1]`, `torso[2]`, as `animate --out x.csv` writes them, with `torso_heading`, or those of `root.position` with
    `root.orientation`. For a GLB file it is the name of a node, whose position in the world is taken along the first
    animation.

    Raises ArgumentError if `source` names no such file, BadFileError if the file is faulty.
    """
    text = str(source)
    found = SOURCE.fullmatch(text)
    if found is None:
        raise ArgumentError(
            f"path: wanted FILE.csv, FILE.csv:PART or FILE.glb:NODE, got {quoted(text)}."
        )
    path = Path(found["file"])
    if found["kind"].lower() == "csv":
        return _from_csv(path, found["part"])
    if found["part"] is None:
        raise ArgumentError(
            f"path: wanted the name of a node after {quoted(text)}, such as {path.name}:Spine2."
        )
    return _of_node(_rig(read_glb(path), path), path, found["part"], text)


def paths_of_nodes(
    file: Glb, where: str | Path, wanted: Collection[str]
) -> dict[str, RecordedPath]:
    """Return the paths of the `wanted` nodes of a GLB file that it has, along its first animation.

    Raises ArgumentError, which lists its nodes, if it has none of them, BadFileError if it is faulty; both say `where`.
    """
    rig = _rig(file, where)
    nodes = {mover_name(str(n.get("name"))): str(n.get("name")) for n in rig.nodes}
    found = [name for name in wanted if name in nodes]
    if not found:
        raise ArgumentError(
            f"no node of {where} is called as a mover. Movers: {listed(wanted) or 'none'}; nodes: "
            f"{listed(map(quoted, sorted(nodes.values())))}. Call them alike, or give --path MOVER=FILE.glb:NODE."
        )
    return {name: _of_node(rig, where, nodes[name], f"{where}:{name}") for name in found}


def mover_name(node: str) -> str:
    """Return the name of the mover that follows a node: without its namespace, and with underscores for signs."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", node.rpartition(":")[2])[:40]


def _rig(file: Glb, where: str | Path) -> Rig:
    """Return the nodes of a file; BadFileError if they are none."""
    try:
        return Rig(file)
    except ValueError as error:
        raise BadFileError(f"{where}: {one_line(error)}.") from error


def _of_node(rig: Rig, where: str | Path, node: str, name: str) -> RecordedPath:
    try:
        times, positions, orientations = node_motion(rig, node)
    except ValueError as error:
        raise BadFileError(f"{where}: {one_line(error)}.") from error
    return RecordedPath(name, times, positions, orientations)


def _from_csv(path: Path, part: str | None) -> RecordedPath:
    content = read_bounded(path, MAX_TABLE)
    position, turns = _names_of(part)
    header = read_header(content, lambda cells: position[0] in map(_name, cells), str(path))
    columns, factors = _columns(header.cells, position, turns, str(path))
    read = read_numbers(content, header, columns, str(path))
    table = read.values * factors
    times = straightened(table[:, 0], factors[0] * resolution_of(read.values[:, 0], read.places))
    _refuse_gaps(times, path)
    turned = table[:, 4:]
    orientations = None
    if turned.shape[1] == 1:
        orientations = facing(turned[:, 0])
    elif turned.shape[1]:
        lengths = np.linalg.norm(turned, axis=1, keepdims=True)
        if (lengths < SHORTEST).any():
            raise BadFileError(f"{path}: a quaternion of zeros is no rotation. Remove the row.")
        orientations = turned / lengths
    return RecordedPath(str(path), times, table[:, 1:4], orientations)


def _refuse_gaps(times: Float[np.ndarray, " T"], path: Path) -> None:
    intervals = np.diff(times)
    gaps = np.flatnonzero(intervals > MAX_GAP * np.median(intervals)) if len(intervals) else []
    if len(gaps):
        before, after = times[gaps[0] : gaps[0] + 2]
        raise BadFileError(
            f"{path}: nothing between {before:g} s and {after:g} s. Fill the gap, or split the table there."
        )


def _name(cell: str) -> str:
    """Return the name of a column without its unit."""
    return TIME if time_column(cell) else without_brackets(cell).partition(" ")[0]


def _columns(
    header: list[str], position: tuple[str, ...], turns: tuple[tuple[str, ...], ...], where: str
) -> tuple[list[int], Float[np.ndarray, " K"]]:
    """Return the indices of time, position, and heading or quaternion, and the factors that make them seconds, metres, radians.

    BadFileError if some are missing, or in another unit.
    """
    names = [_name(cell) for cell in header]
    missing = [name for name in (TIME, *position) if name not in names]
    if missing:
        known = listed(quoted(name) for name in names)
        guess = did_you_mean(missing[0], names)
        raise BadFileError(
            f"{where}: no column {quoted(missing[0])}. {guess}Columns: {known or 'none'}."
        )
    expected = {TIME: "s"} | dict.fromkeys(position, "m")
    for choice in turns:
        if len(expected) == 1 + len(position) and all(name in names for name in choice):
            expected |= dict.fromkeys(choice, "rad" if len(choice) == 1 else "1")
    factors = []
    for name, unit in expected.items():
        if names.count(name) > 1:
            raise BadFileError(f"{where}: two columns are called {quoted(name)}. Rename one.")
        cell = header[names.index(name)]
        time = time_column(cell)
        given = without_brackets(cell).partition(" ")[2].strip()
        factor = time.factor if time else 1.0
        if given and not time:
            known, factor = converted_unit(given, f"{where}: {quoted(name)}")
            if known != unit:
                raise BadFileError(
                    f"{where}: {quoted(name)} is in {quoted(given)}. Convert it to {UNITS[unit]}."
                )
        factors.append(factor)
    return [names.index(name) for name in expected], np.array(factors)


def _names_of(part: str | None) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Return the column names of a position, and the alternatives for an orientation, the preferred one first."""
    if part is None:
        return ("x", "y", "z"), (("heading",), ("qw", "qx", "qy", "qz"))
    position = tuple(f"{part}[{axis}]" for axis in range(3))
    body = part.removesuffix(".position")
    quaternion = tuple(f"{body}.orientation[{entry}]" for entry in range(4))
    return position, ((f"{part}_heading[0]",), quaternion)
