"""The text of a USD file (.usda): prims with their properties, names and numbers as the format writes them.

No name from a stranger reaches the text unchecked: identifiers consist of letters, digits and underscores, and
everything that could end a quoted string is escaped.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import SupportsFloat

import numpy as np
from jaxtyping import Num

DIGITS = 7
"""Significant digits of numbers: single precision."""

TURN_DIGITS = 12
"""Significant digits of quaternions."""

INDENT = "    "


@dataclass
class Prim:
    """A prim: its type, name, metadata in parentheses, properties and children."""

    kind: str
    name: str
    metadata: list[str] = field(default_factory=list)
    properties: list[str] = field(default_factory=list)
    children: list[Prim] = field(default_factory=list)

    def lines(self) -> list[str]:
        """Return the lines of this prim and all below it: without recursion, as a skeleton may be a long chain of bones."""
        written = []
        waiting: list[tuple[Prim | None, str]] = [(self, "")]
        while waiting:
            prim, indent = waiting.pop()
            if prim is None:
                written.append(f"{indent}}}")
                continue
            within = indent + INDENT
            written += prim._head(indent)
            written += [within + line for line in prim.properties]
            waiting.append((None, indent))
            waiting += [(child, within) for child in reversed(prim.children)]
        return written

    def _head(self, indent: str) -> list[str]:
        """Return the lines up to the opening brace."""
        named = f'{indent}def {self.kind} "{self.name}"'
        if not self.metadata:
            return [named, f"{indent}{{"]
        metadata = [indent + INDENT + line for line in self.metadata]
        return [f"{named} (", *metadata, f"{indent})", f"{indent}{{"]


def string(text: str) -> str:
    """Return `text` in quotes, with question marks for characters beyond ASCII."""
    plain = "".join(letter if " " <= letter <= "~" else "?" for letter in text)
    return json.dumps(plain)


def number(value: SupportsFloat) -> str:
    """Return a number in single precision."""
    return f"{float(value):.{DIGITS}g}"


def vector(values: Iterable[SupportsFloat]) -> str:
    """Return numbers in parentheses."""
    return f"({', '.join(map(number, values))})"


def turn(quaternion: Iterable[float]) -> str:
    """Return a quaternion wxyz in double precision: w is nearly 1 for small angles."""
    return f"({', '.join(f'{part:.{TURN_DIGITS}g}' for part in quaternion)})"


def array(values: Num[np.ndarray, "*S"]) -> str:
    """Return numbers (N,), or rows of them (N, D), in brackets."""
    write = number if values.ndim == 1 else vector
    return f"[{', '.join(map(write, values))}]"


def tokens(names: Iterable[str]) -> str:
    """Return words in brackets."""
    return f"[{', '.join(map(json.dumps, names))}]"


def animated(declaration: str, values: Iterable[str]) -> list[str]:
    """Return the lines of a property with a value for each of the frames 0, 1, and so on."""
    rows = [f"{INDENT}{frame}: {value}," for frame, value in enumerate(values)]
    return [f"{declaration}.timeSamples = {{", *rows, "}"]
