"""TOML by strangers: looked over before Python's reader, which recurses, and squares in the length of a key."""

from __future__ import annotations

import re
import tomllib
from typing import Any

MAX_TOML = 512 * 1024
"""Largest text parsed [characters]; the largest of ours has 8,400."""

DEEPEST = 16
"""Deepest list or table in another; ours go four deep."""

MAX_DOTS = 16
"""Dots one key may have."""

MAX_WORD = 64
"""Characters of a number or of a name without quotes; names have at most 40."""

MAX_VALUES = 50_000
"""Commas and equals signs: each value costs time here, in the checks after this, and in what they complain of."""

TOKEN = re.compile(
    r'(?P<text>"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5})?'
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]|\\[^\n])*+"?'
    r"|'[^'\n]*+'?"
    r"|\#[^\n]*+)"
    r"|(?P<word>[A-Za-z0-9_+-]+)"
    r"|(?P<symbol>[\[\]{}.,=])",
    re.DOTALL,
)
"""A string or comment, whose contents do not matter; a number or name; a symbol of the structure.

A string without end goes on to the end of the text or line, as it does for Python's reader, which then stops. Nothing
is tried twice (`*+`), so the time is proportional to the text, whatever it is.
"""


def parse_toml(content: bytes) -> dict[str, Any]:
    """Return what `content`, in UTF-8, holds; raises ValueError in one line."""
    if len(content) > MAX_TOML:
        raise ValueError(f"{len(content):,} bytes; wanted at most {MAX_TOML:,}")
    text = content.decode("utf-8-sig")
    _refuse_extremes(text)
    return tomllib.loads(text)


def _refuse_extremes(text: str) -> None:
    """Refuse what makes Python's reader slow, large or recurse, or its numbers too long to print."""
    depth = 0
    dots = 0
    values = 0
    for match in TOKEN.finditer(text):
        kind = match.lastgroup
        token = match.group()
        if kind == "word" and len(token) > MAX_WORD:
            raise ValueError(
                f"line {_line(text, match)}: {len(token):,} characters in a number or name without quotes"
            )
        if kind != "symbol":
            continue
        if token == ".":
            dots += 1
        else:
            dots = 0
            depth += (token in "[{") - (token in "]}")
            values += token in ",="
        if dots > MAX_DOTS:
            raise ValueError(f"line {_line(text, match)}: more than {MAX_DOTS} dots in one key")
        if depth > DEEPEST:
            raise ValueError(f"line {_line(text, match)}: more than {DEEPEST} lists or tables deep")
        if values > MAX_VALUES:
            raise ValueError(
                f"line {_line(text, match)}: more than {MAX_VALUES:,} values. Use a coarser body"
            )


def _line(text: str, match: re.Match[str]) -> int:
    return text.count("\n", 0, match.start()) + 1
