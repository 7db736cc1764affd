"""JSON from strangers: one object of bounded size and depth, in which no name occurs twice."""

from __future__ import annotations

import json
import math
from typing import Any

from pydantic_core import from_json

from neuroanimator.text import quoted

MAX_DEFINITION = 512 * 1024
"""Maximum size of the JSON text of a system [bytes]: an emulator file carries it in its header."""


def parse_json_object(
    content: bytes | str, largest: int, most_texts: int | None = None
) -> dict[str, Any]:
    """Return the object `content` holds: at most `largest` characters of UTF-8, and `most_texts` texts, names included.

    Raises ValueError in one line, also for NaN and infinite numbers.
    """
    if len(content) > largest:
        raise ValueError(f"{len(content):,} characters of JSON; wanted at most {largest:,}")
    raw = content.encode() if isinstance(content, str) else content
    if most_texts is not None and raw.count(b'"') > 2 * most_texts:
        raise ValueError(f"more than {most_texts:,} names and texts in JSON")
    from_json(raw, allow_inf_nan=False)  # it bounds the depth, and checks texts and numbers
    value = json.loads(raw, object_pairs_hook=_object_of, parse_float=_finite)
    if not isinstance(value, dict):
        raise ValueError(f"wanted a JSON object, got a {type(value).__name__}")
    return value


def _object_of(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the object of these names and values; ValueError if a name occurs twice, which readers treat differently."""
    values: dict[str, Any] = {}
    for name, value in pairs:
        if name in values:
            raise ValueError(f"the name {quoted(name)} occurs twice")
        values[name] = value
    return values


def _finite(text: str) -> float:
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"the number {quoted(text)} is too large")
    return number
