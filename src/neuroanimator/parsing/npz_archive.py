"""NumPy's NPZ by strangers: a ZIP of arrays, read without believing what it says of its sizes, and never pickled."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterable

import numpy as np
from numpy.lib import format as npy

MAX_MEMBERS = 64
"""Files an archive may hold; ours need six."""

MAX_HEADER = 2048
"""Longest header of an array [characters]: NumPy's reader of it is Python's own, which recurses."""

MIN_UNPACKED = 8 * 2**20
"""Bytes the arrays may always take when they are unpacked."""

MAX_GROWTH = 20
"""Maximum ratio of their size to the archive's, beyond that.

Packed recordings grow two to ten times, a bomb a thousand times.
"""

MAX_AXES = 2
"""Axes an array may have: rows and columns."""

MAX_REASON = 200
"""Characters of our own reason that one line quotes."""

MAX_FOREIGN_REASON = 120
"""Characters of a library's reason that one line quotes."""

KINDS = "biufUS"
"""NumPy's letters for truth values, numbers and texts; objects are pickles, which run code."""

PARSERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
"""NumPy's readers of headers by version of the format; later ones are for named columns, which no recording has."""


def parse_npz(content: bytes, wanted: Iterable[str]) -> dict[str, np.ndarray]:
    """Return those of the `wanted` arrays that the archive `content` holds; raises ValueError in one line."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = _members(archive, wanted, len(content))
            return {name: _array(archive, member, name) for name, member in members.items()}
    except (ValueError, MemoryError) as error:
        reason = " ".join(str(error).split())[:MAX_REASON]
        raise ValueError(reason or type(error).__name__) from error
    except Exception as error:
        # zipfile, zlib and NumPy's reader raise whatever the damage makes them trip over.
        reason = " ".join(str(error).split())[:MAX_FOREIGN_REASON]
        raise ValueError(f"{type(error).__name__}: {reason}") from error


def _members(
    archive: zipfile.ZipFile, wanted: Iterable[str], size: int
) -> dict[str, zipfile.ZipInfo]:
    entries = archive.infolist()
    if len(entries) > MAX_MEMBERS:
        raise ValueError(f"{len(entries):,} files in the archive; wanted at most {MAX_MEMBERS}")
    names = [entry.filename for entry in entries]
    members = {}
    for name in wanted:
        file_name = f"{name}.npy"
        if names.count(file_name) > 1:
            raise ValueError(f"array '{name}' is there twice")
        if file_name in names:
            members[name] = entries[names.index(file_name)]
    unpacked = sum(entry.file_size for entry in members.values())
    largest = max(MIN_UNPACKED, MAX_GROWTH * size)
    if unpacked > largest:
        raise ValueError(
            f"{unpacked:,} bytes unpacked; wanted at most {largest:,} for so small a file"
        )
    return members


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str) -> np.ndarray:
    """Return one array, whose header must say exactly what there is."""
    with archive.open(entry) as file:
        content = file.read(entry.file_size)
    header = io.BytesIO(content)
    version = npy.read_magic(header)
    if version not in PARSERS:
        raise ValueError(f"array '{name}' is of version {version}; wanted one of {list(PARSERS)}")
    shape, is_fortran, dtype = PARSERS[version](header, max_header_size=MAX_HEADER)
    if dtype.kind == "O":
        raise ValueError(f"array '{name}': objects are refused, as they can run code")
    if dtype.kind not in KINDS:
        raise ValueError(f"array '{name}' holds {dtype}; wanted numbers or texts")
    if len(shape) > MAX_AXES or any(length < 0 for length in shape):
        raise ValueError(
            f"array '{name}' has {len(shape)} axes or a negative length; wanted at most rows and columns"
        )
    count = math.prod(shape)
    start = header.tell()
    present = len(content) - start
    if count * dtype.itemsize != present:
        raise ValueError(f"array '{name}' claims {count:,} numbers, and holds {present:,} bytes")
    if count == 0:
        return np.zeros(shape, dtype)
    flat = np.frombuffer(content, dtype, count, start)
    return flat.reshape(shape, order="F" if is_fortran else "C")
