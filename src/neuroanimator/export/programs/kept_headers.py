"""Headers that were written and held against JAX on this machine: the next time they need not be made again.

A record lies where nobody else can write, is whole or absent, and is read only if its checksum is right.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from neuroanimator.codegen.kept import sources
from neuroanimator.compiler.compiler import compiler_facts
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.super_step import facts_of_policy
from neuroanimator.emulator.c_emulator import facts_of_emulator
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError, NeuroAnimatorError
from neuroanimator.export.programs.definition import Definition
from neuroanimator.storage.files import canonical_json, read_tensors, write_tensors
from neuroanimator.storage.private_folder import kept_folder

RECORD = "c-header"
"""The kind of file a record is."""

WORD = 4
"""Bytes of an I32: texts that are too long for metadata are kept as such numbers."""


@dataclass(frozen=True)
class CheckedHeader:
    """A header that does what JAX does."""

    text: str
    vectors: str
    """The test vectors that ship beside it, as JSON."""
    count: int
    """Number of inputs it was checked on."""
    difference: float
    """The largest one, in units of the output."""


def kept_header(
    model: Emulator | Policy, definition: Definition, name: str, make: Callable[[], CheckedHeader]
) -> CheckedHeader:
    """Return the header of `model` whose functions begin with `name`: a kept one, or what `make` makes, which is kept."""
    record = _record(model, definition, name)
    known = None if record is None else _read(record)
    if known is not None:
        return known
    made = make()
    if record is not None:
        _write(record, made)
    return made


def _record(model: Emulator | Policy, definition: Definition, name: str) -> Path | None:
    """Return where the header is kept; None where nothing can be."""
    facts = facts_of_policy(model) if isinstance(model, Policy) else facts_of_emulator(model)
    about = [name, canonical_json(definition.facts), *facts, str(compiler_facts()), sources()]
    folder = kept_folder("c-headers")
    if folder is None:
        return None
    key = hashlib.sha256("\n".join(about).encode()).hexdigest()
    return folder / f"{key}.safetensors"


def _read(record: Path) -> CheckedHeader | None:
    """Return the header in a record; None where there is none that is whole."""
    try:
        tensors, metadata = read_tensors(record, RECORD)
        text = _text(tensors["text"])
        vectors = _text(tensors["vectors"])
        return CheckedHeader(text, vectors, metadata["count"], metadata["difference"])
    except (BadFileError, OSError, KeyError):
        return None


def _write(record: Path, header: CheckedHeader) -> None:
    """Keep a header; where there is no room for it, the next process makes it again."""
    tensors = {"text": _words(header.text), "vectors": _words(header.vectors)}
    metadata = {"kind": RECORD, "count": header.count, "difference": header.difference}
    try:
        write_tensors(record, tensors, metadata)
    except (OSError, NeuroAnimatorError):
        record.unlink(missing_ok=True)


def _words(text: str) -> Int[np.ndarray, " W"]:
    """Return a text of ASCII as whole numbers, filled up with zeros."""
    raw = text.encode("ascii")
    return np.frombuffer(raw + bytes(-len(raw) % WORD), "<i4")


def _text(words: Int[np.ndarray, " W"]) -> str:
    return words.tobytes().rstrip(b"\0").decode("ascii")
