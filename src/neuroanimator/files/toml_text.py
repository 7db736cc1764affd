"""TOML from strangers: scanned before Python's reader, which recurses, and is quadratic in the length of a key."""

from __future__ import annotations

import re
import tomllib
from typing import Any

MAX_TOML = 512 * 1024
"""Maximum size of a text parsed [characters]; the largest of ours has 8,400."""

DEEPEST = 16
"""Maximum depth of nested lists and tables; ours go four deep."""

MAX_DOTS = 16
"""Maximum number of dots in a key."""

MAX_WORD = 64
"""Maximum number of characters of a number or of a name without quotes; names have at most 40."""

MAX_VALUES = 50_000
"""Maximum number of values, counted by commas and equals signs: each costs time here, in later checks, and in messages."""

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

A string without end extends to the end of the text or line, as for Python's reader, which then stops. Nothing is tried
twice (`*+`), so the time is proportional to the length of any text.
"""


def parse_toml(content: bytes) -> dict[str, Any]:
    """Return the table in `content`, in UTF-8; raises ValueError in one line."""
    if len(content) > MAX_TOML:
        raise ValueError(f"{len(content):,} bytes; wanted at most {MAX_TOML:,}")
    text = content.decode("utf-8-sig")
    _refuse_extremes(text)
    return tomllib.loads(text)


def _refuse_extremes(text: str) -> None:
    """Refuse text that makes Python's reader slow, large or recursive, or numbers too long to print."""
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
