"""Files that are whole or absent, and safetensors files that are checked before use."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from neuroanimator.errors import BadFileError, ResourceError
from neuroanimator.files.json_text import parse_json_object
from neuroanimator.files.places import Place, UrlPath
from neuroanimator.files.sources import refuse_source
from neuroanimator.files.unfinished import refuse_other_than_file, replace_together

METADATA_KEY = "na"
"""The only metadata key; with two or more, safetensors' bytes differ from run to run."""

SIZE_LIMIT = 64 * 2**20
"""Maximum size of a file read [bytes]; shards and emulators stay far below."""

HEADER_LIMIT = 2**20
"""Maximum size of a safetensors header [bytes]."""

TENSOR_LIMIT = 256
"""Maximum number of tensors in a file: a crowded header is a known way to slow a reader down."""

LENGTH_BYTES = 8
"""Size of the header's length at the start of a safetensors file [bytes]."""

MAX_AXES = 8
"""Maximum number of axes of a tensor; ours have three."""

MAX_SHOWN = 40
"""Maximum number of characters of a file's own text that a message quotes."""

MAX_REASON = 200
"""Maximum number of characters of another error's message that one line quotes."""

MAX_ID_DIGITS = 20
"""Maximum number of bytes read of a lock file, which holds a process id."""

DTYPES = {
    "F32": np.dtype("<f4"),
    "F64": np.dtype("<f8"),
    "I8": np.dtype("i1"),
    "I16": np.dtype("<i2"),
    "I32": np.dtype("<i4"),
}
"""Number types of tensors, by safetensors' names, as NumPy's."""

FULL = (errno.ENOSPC, errno.EDQUOT)
"""Error codes of a full disk or quota."""

Tensors = dict[str, np.ndarray]
"""Arrays by their names in a file."""

Metadata = dict[str, Any]
"""What a file says about its arrays, as JSON values."""


def canonical_json(value: Any) -> str:
    """Return the one JSON text of `value`: sorted keys, no spaces, no NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(tensors: Tensors) -> str:
    """Return the sha256 over names, types, shapes and bytes of `tensors`, in any order."""
    total = hashlib.sha256()
    for name in sorted(tensors):
        array = np.asarray(tensors[name], order="C")
        total.update(f"{name}:{array.dtype}:{array.shape};".encode())
        total.update(array.reshape(-1).view(np.uint8).data)
    return total.hexdigest()


def write_whole(path: Place, content: bytes) -> None:
    """Write `content` so that a reader, or a kill at any moment, finds the old file or the new one.

    Raises ResourceError; if the disk is full, it gives the number of bytes needed.
    """
    if isinstance(path, UrlPath):
        path.write(content)
        return
    write_together({path: content})


def write_together(files: Mapping[Path, bytes]) -> None:
    """Write files that belong together as `write_whole` writes one, the last one last: all of them, or none.

    Raises as `write_whole`, naming the last one.
    """
    try:
        replace_together(files)
    except OSError as error:
        need = ""
        if error.errno in FULL:
            need = f" ({sum(map(len, files.values())):,} bytes needed)"
        path = list(files)[-1]
        raise ResourceError(f"Could not write {path}: {error.strerror}{need}.") from error


def write_first(path: Place, content: bytes) -> bool:
    """Write a file as `write_whole` does unless it is there already; return whether it was written.

    On a disk the folder's lock keeps others away; an object store has none, and decides itself.
    """
    if isinstance(path, UrlPath):
        return path.create(content)
    write_whole(path, content)
    return True


def append_line(path: Path, line: str) -> None:
    """Append `line` to a log; ResourceError names the file if that fails."""
    try:
        refuse_other_than_file(path)
        with open(path, "a", encoding="utf-8") as file:
            file.write(line + "\n")
    except OSError as error:
        raise ResourceError(f"Could not write {path}: {error.strerror}.") from error


@contextmanager
def locked(folder: Place) -> Iterator[None]:
    """Hold `folder` for this process alone; refuse with the other's process id if it is taken.

    An object store has no locks: nothing is held, and other processes that write there must write the same bytes.
    """
    if isinstance(folder, UrlPath):
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(
            folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666
        )
    except OSError as error:
        raise ResourceError(f"Could not use the folder {folder}: {error.strerror}.") from error
    try:
        _take_lock(handle, folder)
        # The process id is only for the message to others: on a full disk the lock holds without it.
        with suppress(OSError):
            os.ftruncate(handle, 0)
            os.pwrite(handle, str(os.getpid()).encode(), 0)
        yield
    finally:
        os.close(handle)


def _take_lock(handle: int, folder: Path) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        process = os.pread(handle, MAX_ID_DIGITS, 0).decode(errors="replace").strip()
        holder = f"process {process}" if process.isdecimal() else "another process"
        raise ResourceError(
            f"{folder} is in use by {holder}. Wait for it, or choose another folder."
        ) from error
    except OSError as error:
        raise ResourceError(f"Could not lock the folder {folder}: {error.strerror}.") from error


def _seal(tensors: Tensors, metadata: Metadata) -> str:
    """Return the sha256 that covers the tensors and all other metadata."""
    others = {key: value for key, value in metadata.items() if key != "sha256"}
    sealed = canonical_json(others) + digest(tensors)
    return hashlib.sha256(sealed.encode()).hexdigest()


def write_tensors(path: Place, tensors: Tensors, metadata: Metadata) -> None:
    """Write a safetensors file whose metadata also holds the sha256 of everything in it. Same input, same bytes."""
    ordered = {name: np.asarray(tensors[name], order="C") for name in sorted(tensors)}
    text = canonical_json({**metadata, "sha256": _seal(ordered, metadata)})
    write_whole(path, safetensors.numpy.save(ordered, {METADATA_KEY: text}))


def read_tensors(path: Place, *kinds: str, largest: int = SIZE_LIMIT) -> tuple[Tensors, Metadata]:
    """Return (tensors, metadata) of a file written by `write_tensors` whose metadata name one of `kinds`.

    The tensors are read-only. Raises BadFileError naming the file and the fault for any other bytes, and for more than
    `largest` [bytes].
    """
    raw = read_bounded(path, largest)
    try:
        header = _read_header(raw)
        metadata = _take_metadata(header)
        if len(header) > TENSOR_LIMIT:
            raise ValueError(f"{len(header)} tensors; wanted at most {TENSOR_LIMIT}")
        tensors = _parse_tensors(raw)
        _check_payload(tensors, metadata, kinds)
    except (ValueError, safetensors.SafetensorError) as error:
        refuse_source(str(path), f"{kinds[0]} file")
        raise BadFileError(
            f"{path} is not a usable {kinds[0]} file: {one_line(error)}. Make it again."
        ) from error
    return tensors, metadata


def read_bounded(path: Place, largest: int) -> bytes:
    """Return the bytes of a file; BadFileError if it cannot be read or is larger than `largest` [bytes]."""
    if isinstance(path, UrlPath):
        return path.read(largest)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise BadFileError(f"{path} is not a file: a folder, a pipe or a device. Give a file.")
        if status.st_size > largest:
            raise BadFileError(f"{path}: {status.st_size:,} bytes; wanted at most {largest:,}.")
        with open(path, "rb") as file:
            return file.read(largest)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL character
        reason = error.strerror if isinstance(error, OSError) else error
        raise BadFileError(f"Could not read {path}: {reason}. Check the path.") from error


def _read_header(raw: bytes) -> dict[str, Any]:
    length = int.from_bytes(raw[:LENGTH_BYTES], "little")
    if len(raw) < LENGTH_BYTES or length > HEADER_LIMIT:
        raise ValueError("truncated, or not a safetensors file")
    return parse_json_object(raw[LENGTH_BYTES : LENGTH_BYTES + length], HEADER_LIMIT)


def _take_metadata(header: dict[str, Any]) -> dict[str, Any]:
    metadata = header.pop("__metadata__", None)
    if not isinstance(metadata, dict) or set(metadata) != {METADATA_KEY}:
        raise ValueError(f"wanted one metadata key '{METADATA_KEY}'")
    text = metadata[METADATA_KEY]
    if not isinstance(text, str):
        raise ValueError("its metadata is not text")
    return parse_json_object(text, HEADER_LIMIT)


def _parse_tensors(raw: bytes) -> Tensors:
    """Return the tensors of a safetensors file; the library checks their offsets."""
    tensors = {}
    for name, entry in safetensors.deserialize(raw):
        dtype = DTYPES.get(entry["dtype"])
        if dtype is None or len(entry["shape"]) > MAX_AXES:
            raise ValueError(
                f"tensor {name[:MAX_SHOWN]!r}: wanted at most {MAX_AXES} axes of {', '.join(DTYPES)}"
            )
        flat = np.frombuffer(entry["data"], dtype)
        flat.flags.writeable = False
        tensors[name] = flat.reshape(entry["shape"])
    return tensors


def _check_payload(tensors: Tensors, metadata: Metadata, kinds: tuple[str, ...]) -> None:
    if metadata.get("kind") not in kinds:
        raise ValueError(f"it says it is a {str(metadata.get('kind'))[:MAX_SHOWN]!r}")
    for name, array in tensors.items():
        if not np.isfinite(array).all():
            raise ValueError(f"tensor {name[:MAX_SHOWN]!r} holds NaN or infinite numbers")
    if metadata.get("sha256") != _seal(tensors, metadata):
        raise ValueError("its contents do not match its sha256 (damaged)")


def one_line(error: Exception) -> str:
    """Return the message of `error` in one line of bounded length."""
    return " ".join(str(error).split())[:MAX_REASON] or type(error).__name__
