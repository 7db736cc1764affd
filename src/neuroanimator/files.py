"""Files that are whole or absent, and safetensors files that are checked before they are used."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from neuroanimator.errors import BadFileError, ResourceError
from neuroanimator.unfinished import finish, unfinished

METADATA_KEY = "na"
"""The one metadata key; with two or more, safetensors' bytes differ from run to run."""

SIZE_LIMIT = 64 * 2**20
"""Largest file read [bytes]; shards and emulators stay far below."""

HEADER_LIMIT = 2**20
"""Largest safetensors header parsed [bytes]."""

TENSOR_LIMIT = 256
"""Most tensors in a file: a crowded header is a known way to make a reader slow."""

DTYPES = {"F32", "F64", "I32"}

FULL = (errno.ENOSPC, errno.EDQUOT)


def canonical_json(value: Any) -> str:
    """Return the one JSON text of `value`: sorted keys, no spaces, no NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def digest(tensors: dict[str, np.ndarray]) -> str:
    """Return the sha256 over names, types, shapes and bytes of `tensors`, whatever their order."""
    total = hashlib.sha256()
    for name in sorted(tensors):
        array = np.asarray(tensors[name], order="C")
        total.update(f"{name}:{array.dtype}:{array.shape};".encode())
        total.update(array.tobytes())
    return total.hexdigest()


def write_whole(path: Path, content: bytes) -> None:
    """Write `content` so that a reader, or a kill at any moment, finds the old file or the new one.

    Raises ResourceError, which says how many bytes were needed where the disk is full.
    """
    try:
        with unfinished(path) as temporary:
            with open(temporary, "xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            finish(temporary, path)
    except OSError as error:
        need = f" ({len(content):,} bytes needed)" if error.errno in FULL else ""
        raise ResourceError(f"Could not write {path}: {error.strerror}{need}.") from error


def append_line(path: Path, line: str) -> None:
    """Append `line` to a log; ResourceError names the file if that fails."""
    try:
        with open(path, "a", encoding="utf-8") as file:
            file.write(line + "\n")
    except OSError as error:
        raise ResourceError(f"Could not write {path}: {error.strerror}.") from error


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold `folder` for this process alone; refuse with the other's process id if it is taken."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise ResourceError(f"Could not use the folder {folder}: {error.strerror}.") from error
    try:
        _take_lock(handle, folder)
        # Who holds it is only a word to whoever comes second: on a full disk the lock holds without.
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
        number = os.pread(handle, 20, 0).decode(errors="replace").strip()
        holder = f"process {number}" if number.isdecimal() else "another process"
        raise ResourceError(f"{folder} is in use by {holder}. Wait for it, or choose another folder.") from error
    except OSError as error:
        raise ResourceError(f"Could not lock the folder {folder}: {error.strerror}.") from error


def _seal(tensors: dict[str, np.ndarray], metadata: dict[str, Any]) -> str:
    """Return the sha256 that covers the tensors and all other metadata."""
    others = {key: value for key, value in metadata.items() if key != "sha256"}
    return hashlib.sha256((canonical_json(others) + digest(tensors)).encode()).hexdigest()


def write_tensors(path: Path, tensors: dict[str, np.ndarray], metadata: dict[str, Any]) -> None:
    """Write a safetensors file whose metadata also holds the sha256 of everything in it. Same input, same bytes."""
    ordered = {name: np.asarray(tensors[name], order="C") for name in sorted(tensors)}
    text = canonical_json({**metadata, "sha256": _seal(ordered, metadata)})
    write_whole(path, safetensors.numpy.save(ordered, {METADATA_KEY: text}))


def read_tensors(path: Path, kind: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return (tensors, metadata) of a file written by `write_tensors` whose metadata says it is a `kind`.

    Raises BadFileError naming the file and the fault, whatever the bytes are.
    """
    raw = _read_bytes(path)
    try:
        metadata = _check_header(raw)
        tensors = safetensors.numpy.load(raw)
        _check_payload(tensors, metadata, kind)
    except (ValueError, RecursionError, KeyError, TypeError, safetensors.SafetensorError) as error:
        raise BadFileError(f"{path} is not a usable {kind} file: {_one_line(error)}. Make it again.") from error
    return tensors, metadata


def _read_bytes(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > SIZE_LIMIT:
            raise BadFileError(f"{path}: {size:,} bytes; wanted at most {SIZE_LIMIT:,}.")
        return path.read_bytes()
    except OSError as error:
        raise BadFileError(f"Could not read {path}: {error.strerror}. Check the path.") from error


def _check_header(raw: bytes) -> dict[str, Any]:
    length = int.from_bytes(raw[:8], "little")
    if len(raw) < 8 or length > min(HEADER_LIMIT, len(raw) - 8):
        raise ValueError("truncated, or not a safetensors file")
    header = json.loads(raw[8 : 8 + length], object_pairs_hook=_unique_keys)
    metadata = header.pop("__metadata__", None)
    if not isinstance(metadata, dict) or set(metadata) != {METADATA_KEY}:
        raise ValueError(f"wanted one metadata key '{METADATA_KEY}'")
    if len(header) > TENSOR_LIMIT:
        raise ValueError(f"{len(header)} tensors; wanted at most {TENSOR_LIMIT}")
    for name, entry in header.items():
        if entry["dtype"] not in DTYPES:
            raise ValueError(f"tensor '{name[:40]}' has dtype {entry['dtype']}; wanted one of {sorted(DTYPES)}")
    parsed = json.loads(metadata[METADATA_KEY], object_pairs_hook=_unique_keys)
    if not isinstance(parsed, dict):
        raise ValueError("metadata is not a JSON object")
    return parsed


def _check_payload(tensors: dict[str, np.ndarray], metadata: dict[str, Any], kind: str) -> None:
    if metadata.get("kind") != kind:
        raise ValueError(f"it says it is a '{str(metadata.get('kind'))[:40]}'")
    for name, array in tensors.items():
        if not np.isfinite(array).all():
            raise ValueError(f"tensor '{name[:40]}' holds NaN or infinite numbers")
    if metadata.get("sha256") != _seal(tensors, metadata):
        raise ValueError("its contents do not match its sha256 (damaged)")


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len({key for key, _ in pairs}) < len(pairs):
        raise ValueError("a name occurs twice in its header")
    return dict(pairs)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
