"""NumPy's NPZ by strangers: a ZIP of arrays, read without believing what it says of its sizes, and never pickled."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Iterable

import numpy as np
from numpy.lib import format as npy

MAX_MEMBERS = 64
"""Files in the archive; ours need six."""

MAX_HEADER = 2048
"""Longest header of an array [characters]: NumPy's reader of it is Python's own, which recurses."""

MIN_UNPACKED, MAX_GROWTH = 8 * 2**20, 20
"""Unpacked, the arrays may take so many bytes, or so many times what the archive takes: packed recordings grow two to
ten times, a bomb a thousand times."""

KINDS = "biufUS"
"""NumPy's letters for truth values, numbers and texts; objects are pickles, which run code."""

PARSERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
"""By version of the format; later ones are for named columns, which no recording has."""


def parse_npz(content: bytes, wanted: Iterable[str]) -> dict[str, np.ndarray]:
    """Return those of the `wanted` arrays that the archive `content` holds; raises ValueError in one line."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = _members(archive, wanted, len(content))
            return {name: _array(archive, member, name) for name, member in members.items()}
    except (ValueError, MemoryError) as error:
        raise ValueError(" ".join(str(error).split())[:200] or type(error).__name__) from error
    except (
        Exception
    ) as error:  # zipfile, zlib and NumPy's reader raise whatever the damage makes them trip over
        raise ValueError(f"{type(error).__name__}: {' '.join(str(error).split())[:120]}") from error


def _members(
    archive: zipfile.ZipFile, wanted: Iterable[str], size: int
) -> dict[str, zipfile.ZipInfo]:
    entries = archive.infolist()
    if len(entries) > MAX_MEMBERS:
        raise ValueError(f"{len(entries):,} files in the archive; wanted at most {MAX_MEMBERS}")
    names = [entry.filename for entry in entries]
    found = {}
    for name in wanted:
        if names.count(f"{name}.npy") > 1:
            raise ValueError(f"array '{name}' is there twice")
        if f"{name}.npy" in names:
            found[name] = entries[names.index(f"{name}.npy")]
    unpacked = sum(entry.file_size for entry in found.values())
    most = max(MIN_UNPACKED, MAX_GROWTH * size)
    if unpacked > most:
        raise ValueError(
            f"{unpacked:,} bytes unpacked; wanted at most {most:,} for so small a file"
        )
    return found


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
    if len(shape) > 2 or any(length < 0 for length in shape):
        raise ValueError(
            f"array '{name}' has {len(shape)} axes or a negative length; wanted at most rows and columns"
        )
    count = math.prod(shape)
    start = header.tell()
    if count * dtype.itemsize != len(content) - start:
        raise ValueError(
            f"array '{name}' claims {count:,} numbers, and holds {len(content) - start:,} bytes"
        )
    if count == 0:
        return np.zeros(shape, dtype)
    return np.frombuffer(content, dtype, count, start).reshape(
        shape, order="F" if is_fortran else "C"
    )
