"""Errors as the page may see them: one line, no folders of this machine, no traces."""

from __future__ import annotations

import os
import re
import traceback

from neuroanimator.authoring import print_line, printable

FOLDERS = re.compile(r"(?<![\w./])/(?:[^\s/:'\"]+/)+")
"""The folders of an absolute path; the file's name behind them may be shown."""

MAX_WORDS = 500
"""Characters of a line."""

UNEXPECTED = "Unexpected error in the server. The terminal it runs in says more."


def public_words(words: str) -> str:
    """Return `words` as one line that names no folder."""
    line = " ".join(words.split())
    return printable(FOLDERS.sub("", line))[:MAX_WORDS]


def say_unexpected(error: Exception) -> str:
    """Say in the terminal what went wrong, and return what the page may be told."""
    print_line(
        f"neuroanimator: Unexpected {type(error).__name__}: {error}. Please report it.",
        to_stderr=True,
    )
    if os.environ.get("NEUROANIMATOR_DEBUG"):
        traceback.print_exception(error)
    return UNEXPECTED
