"""Files of an export: a program checked against JAX, its test vectors and its wrappers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from neuroanimator.export.programs.definition import ProgramDefinition
from neuroanimator.export.programs.vectors import Vectors, vectors_text
from neuroanimator.files.atomic import write_together

VECTORS_SUFFIX = ".vectors.json"
"""Suffix of the file of test vectors, instead of the program's."""


@dataclass(frozen=True)
class CheckedProgram:
    """A program that agrees with JAX."""

    content: bytes
    functions: Mapping[str, Vectors]
    """Test vectors of each of its functions, by name."""
    runtime: str
    """Name of the runtime it was checked in."""
    difference: float
    """Largest difference from JAX, in units of the outputs."""


@dataclass(frozen=True)
class ExportedFiles:
    """An exported program, and the files beside it."""

    path: Path
    others: tuple[Path, ...]
    """Wrappers that call it, and test vectors."""
    size: int
    """Size of the program [bytes]."""
    runtime: str
    checked: int
    """Number of inputs it was checked on."""
    difference: float
    """Largest difference from JAX, in units of the outputs."""
    missing: str = ""
    """Sentence on what an older model lacks, and the remedy."""

    def summary(self) -> str:
        """Return one line: the file, its size, and how it was checked."""
        others = ", ".join(path.name for path in self.others)
        told = (
            f"{self.path}: {self.size / 1e3:.0f} kB; in {self.runtime} {self.checked:,} inputs give what they give in "
            f"JAX, to {self.difference:.0e} of the output's scale. Beside it: {others}."
        )
        return f"{told} {self.missing}" if self.missing else told


def write_program(
    path: str | Path,
    definition: ProgramDefinition,
    program: CheckedProgram,
    callers: Mapping[str, bytes] | None = None,
) -> ExportedFiles:
    """Write a program to `path`, and beside it `callers`, by suffix, and test vectors (`fish.vectors.json`)."""
    path = Path(path)
    vectors = vectors_text(definition, program.functions).encode("ascii")
    suffixes = {**(callers or {}), VECTORS_SUFFIX: vectors}
    others = {path.with_suffix(suffix): content for suffix, content in suffixes.items()}
    write_together({**others, path: program.content})
    return ExportedFiles(
        path=path,
        others=tuple(others),
        size=len(program.content),
        runtime=program.runtime,
        checked=program.functions[definition.name].count,
        difference=program.difference,
        missing=definition.missing,
    )
