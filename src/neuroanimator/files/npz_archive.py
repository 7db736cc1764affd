"""NumPy's NPZ from strangers: a ZIP of arrays, whose claimed sizes are not trusted, and without pickles."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable

import numpy as np
from numpy.lib import format as npy

from neuroanimator.files.atomic import one_line

MAX_MEMBERS = 64
"""Maximum number of files in an archive; ours need six."""

MAX_HEADER = 2048
"""Maximum length of an array's header [characters]: NumPy reads it with Python's own parser, which recurses."""

MIN_UNPACKED = 8 * 2**20
"""Size that unpacked arrays may always take [bytes]."""

MAX_GROWTH = 20
"""Maximum ratio of their size to the archive's, above that size.

Packed recordings grow two to ten times, a zip bomb a thousand times.
"""

MAX_AXES = 2
"""Maximum number of axes of an array: rows and columns."""

MAX_FOREIGN_REASON = 120
"""Maximum number of characters of a library's reason that one line quotes."""

KINDS = "biufUSmM"
"""NumPy's kinds of truth values, numbers, texts and times; objects are pickles, which run code."""


def parse_npz(content: bytes, wanted: Iterable[str]) -> dict[str, np.ndarray]:
    """Return the `wanted` arrays that are in the archive `content`; raises ValueError in one line."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = _members(archive, wanted, len(content))
            return {name: _array(archive, member, name) for name, member in members.items()}
    except (ValueError, MemoryError) as error:
        raise ValueError(one_line(error)) from error
    except Exception as error:
        # zipfile, zlib and NumPy's reader raise errors of any kind on damaged bytes.
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
            raise ValueError(f"array '{name}' occurs twice")
        if file_name in names:
            members[name] = entries[names.index(file_name)]
    unpacked = sum(entry.file_size for entry in members.values())
    largest = max(MIN_UNPACKED, MAX_GROWTH * size)
    if unpacked > largest:
        raise ValueError(
            f"{unpacked:,} bytes unpacked; wanted at most {largest:,} for a file this small"
        )
    return members


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str) -> np.ndarray:
    """Return one array, as NumPy reads it: its header's claims count only as far as there are bytes."""
    with archive.open(entry) as file:
        content = io.BytesIO(file.read(entry.file_size))
    array = npy.read_array(content, allow_pickle=False, max_header_size=MAX_HEADER)
    if array.dtype.kind not in KINDS or array.ndim > MAX_AXES:
        raise ValueError(
            f"array '{name}' holds {array.dtype} along {array.ndim} axes; wanted numbers or texts in rows and columns"
        )
    return array
