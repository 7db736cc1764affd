"""Lines of text from strangers, one at a time and of bounded length."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Literal

MAX_LINE = 128 * 1024
"""Maximum number of characters in a line: a thousand columns at full precision take a fifth of it."""


class TextError(ValueError):
    """A line is too long, or no text; the message names it."""


def text_lines(
    content: bytes, errors: Literal["strict", "replace"] = "strict"
) -> Iterator[tuple[int, str]]:
    """Yield (line number from 1, text without its end) of every line of `content`, in UTF-8.

    Raises TextError naming the line that is too long, or that is no text unless such bytes are to be replaced.
    """
    text = io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig", errors=errors)
    number = 0
    try:
        while line := text.readline(MAX_LINE + 1):
            number += 1
            if len(line) > MAX_LINE:
                raise TextError(f"line {number}: more than {MAX_LINE:,} characters in a line")
            yield number, line.rstrip("\n")
    except UnicodeDecodeError as error:
        raise TextError(
            f"after line {number}: not text in UTF-8 ({error.reason}). Save it in UTF-8"
        ) from error
