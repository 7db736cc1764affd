"""JSON by strangers: one object of bounded size and depth, every name once, every number finite."""

from __future__ import annotations

import json
import math
import re
from typing import Any, NoReturn

import numpy as np

DEEPEST = 32
"""Deepest list or object in another; ours go ten deep, and Python's reader recurses."""

MAX_DIGITS = 18
"""Digits a whole number may have: all that fit in 64 bits, and far below what Python takes long to convert."""

MAX_DEFINITION = 512 * 1024
"""Maximum size of the JSON text of a system [bytes]: an emulator file carries it in its header."""

MAX_SHOWN = 40
"""Characters of a text shown in an error."""

STRING = re.compile(rb'"[^"\\]*+(?:\\.[^"\\]*+)*+"?', re.DOTALL)
"""A text in quotes, or what begins as one. Nothing is tried twice (`*+`), so that the time is proportional to the text."""

OPENING = np.frombuffer(b"[{", np.uint8)
"""Opening brackets of lists and objects."""

CLOSING = np.frombuffer(b"]}", np.uint8)
"""Closing brackets."""

HALF_CHARACTER = re.compile(r"\\u[dD][89a-fA-F]")
"""An escape that is half of a character beyond 16 bits: alone it is none, and cannot be written out again."""


def parse_json_object(
    content: bytes | str, largest: int, most_texts: int | None = None
) -> dict[str, Any]:
    """Return the object `content` holds: at most `largest` characters of UTF-8, and `most_texts` texts, names included.

    Raises ValueError in one line, also for names that occur twice, NaN, infinite numbers and whole numbers
    beyond 64 bits.
    """
    if len(content) > largest:
        raise ValueError(f"{len(content):,} characters of JSON; wanted at most {largest:,}")
    raw = content.encode() if isinstance(content, str) else content
    if most_texts is not None and raw.count(b'"') > 2 * most_texts:
        raise ValueError(f"more than {most_texts:,} names and texts in JSON")
    text = raw.decode()
    _refuse_depth(raw)
    value = json.loads(
        text,
        object_pairs_hook=_unique_names,
        parse_int=_whole_number,
        parse_float=_finite_number,
        parse_constant=_refuse_constant,
    )
    if not isinstance(value, dict):
        raise ValueError(f"wanted a JSON object, came a {type(value).__name__}")
    if HALF_CHARACTER.search(text):
        _refuse_half_characters(value)
    return value


def _refuse_depth(content: bytes) -> None:
    symbols = np.frombuffer(STRING.sub(b"", content), np.uint8)
    opening = np.isin(symbols, OPENING)
    closing = np.isin(symbols, CLOSING)
    depths = np.cumsum(opening.astype(np.int8) - closing.astype(np.int8), dtype=np.int32)
    if depths.max(initial=0) > DEEPEST:
        raise ValueError(f"JSON more than {DEEPEST} lists or objects deep")


def _unique_names(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        earlier: set[str] = set()
        for name, _ in pairs:
            if name in earlier:
                raise ValueError(f"the name {name[:MAX_SHOWN]!r} occurs twice")
            earlier.add(name)
    return members


def _whole_number(text: str) -> int:
    if len(text.lstrip("-")) > MAX_DIGITS:
        raise ValueError(f"a whole number of {len(text):,} digits; wanted at most {MAX_DIGITS}")
    return int(text)


def _finite_number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"the number {text[:MAX_SHOWN]} is too large")
    return number


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON number")


def _refuse_half_characters(value: dict[str, Any]) -> None:
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        raise ValueError("a text holds half a character (a lone surrogate)") from error
