"""The page of a report: how it looks, what stands at its head, and what its words mean."""

from __future__ import annotations

import html
import shlex
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from neuroanimator.machine import describe_machine
from neuroanimator.storage.files import write_whole
from neuroanimator.text import printable

VIEWPORT = "<meta name=viewport content='width=device-width,initial-scale=1'>"
"""Without it a phone shows a page as wide as a desk's, and tiny."""

STYLE = """:root{color-scheme:light dark;--line:#dde3ea;--bar:#e8892b}
body{font:16px/1.55 system-ui,sans-serif;color:#1c2733;background:#fff;max-width:62rem;margin:2rem auto;padding:0 1rem;
overflow-wrap:break-word}
h1{font-size:1.6rem}h2{margin-top:2.2rem;font-size:1.2rem}h3{margin-top:1.8rem;font-size:1rem}
.wide{overflow-x:auto}table{border-collapse:collapse;margin:1rem 0}
td,th{padding:.3rem .8rem;border-bottom:1px solid var(--line);text-align:right;white-space:nowrap}
th{white-space:normal;vertical-align:bottom}td:first-child,th:first-child{text-align:left}
.made{font-size:.85rem;opacity:.75}svg,video{max-width:100%;height:auto}p{max-width:46rem}
.facts th{vertical-align:top;min-width:9rem}.facts td{text-align:left;white-space:normal}
svg.plot{width:100%;max-width:42rem}.wide svg.plot{min-width:36rem;max-width:none}
dt{font-weight:600}dd{margin:0 0 .4rem 1rem}
svg.bars{width:9rem;height:1.6rem;fill:var(--bar);vertical-align:middle}
@media (max-width:40rem){td,th{padding:.3rem .4rem;font-size:.85rem}}
@media (prefers-color-scheme:dark){:root{--line:#3a4653}body{color:#dbe3ec;background:#14191f}
svg.plot{filter:invert(.92) hue-rotate(180deg)}}"""
"""How the page looks: on a phone wide tables scroll by themselves; in the dark plots are turned from light to dark."""


def write_page(path: str | Path, title: str, parts: Sequence[str]) -> None:
    """Write `parts`, each HTML, one below another as a page that needs no other file."""
    head = f"<!doctype html><html lang=en><meta charset=utf-8>{VIEWPORT}<title>{html.escape(title)}</title><style>{STYLE}</style>"
    page = head + "".join(parts) + "</html>\n"
    write_whole(Path(path), page.encode())


def made_html() -> str:
    """Return when, by what command and on what machine the page was made."""
    day = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    program = Path(sys.argv[0]).name
    command = shlex.join([program, *sys.argv[1:]])
    return (
        f"<p class=made>Made {day} by NeuroAnimator {version('neuroanimator')} on {html.escape(describe_machine())}:<br>"
        f"<code>{html.escape(printable(command))}</code></p>"
    )


def glossary_html(title: str, meanings: Mapping[str, str]) -> str:
    """Return what words mean, to be unfolded below `title`."""
    lines = ""
    for word, meaning in meanings.items():
        lines += f"<dt>{html.escape(word)}</dt><dd>{html.escape(meaning)}</dd>"
    return f"<details><summary>{html.escape(title)}</summary><dl>{lines}</dl></details>"


def table_html(rows: Sequence[Mapping[str, object]], pictures: str = "") -> str:
    """Return rows of the same heads as a table; the cells under `pictures` are SVG, all others text."""
    heads = "".join(f"<th>{html.escape(head)}</th>" for head in rows[0])
    lines = f"<tr>{heads}</tr>"
    for row in rows:
        cells = ""
        for head, value in row.items():
            cells += f"<td>{value if head == pictures else html.escape(str(value))}</td>"
        lines += f"<tr>{cells}</tr>"
    return f"<div class=wide><table>{lines}</table></div>"


def facts_html(facts: Sequence[tuple[str, object]]) -> str:
    """Return names and values as a table."""
    lines = ""
    for name, value in facts:
        lines += f"<tr><th>{html.escape(name)}</th><td>{html.escape(str(value))}</td></tr>"
    return f"<div class=wide><table class=facts>{lines}</table></div>"
