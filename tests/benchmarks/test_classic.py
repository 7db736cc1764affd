"""The page about the network of 1998 draws what its tables say, and is light."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "classic.md"

MAX_PICTURE = 60_000
"""Largest picture of the page [bytes]."""

DECIMAL = re.compile(r"\d[\d,]*\.\d+")
TABLE = re.compile(r"^\|.*\|$", re.MULTILINE)
QUOTE = re.compile(r"^>.*$", re.MULTILINE)
CODE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
TARGET = re.compile(r"\]\([^)]*\)")


def test_every_decimal_in_the_text_stands_in_a_table_of_its_section():
    sections = PAGE.read_text(encoding="utf-8").split("\n## ")
    for section in sections:
        figures = set(DECIMAL.findall("\n".join(TABLE.findall(section))))
        prose = section
        for pattern in (TABLE, QUOTE, CODE, TARGET):
            prose = pattern.sub("", prose)
        assert set(DECIMAL.findall(prose)) <= figures, section.splitlines()[0]


def test_the_page_shows_every_picture_and_all_are_small():
    text = PAGE.read_text(encoding="utf-8")
    shown = {Path(name).stem for name in re.findall(r"\(images/classic/([\w-]+\.png)\)", text)}
    assert shown == {path.stem for path in (DOCS / "images" / "classic").iterdir()}
    for name in shown:
        assert (DOCS / "images" / "classic" / f"{name}.png").stat().st_size <= MAX_PICTURE
