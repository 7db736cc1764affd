"""Reports as pages: values filled into templates, and how they are written there."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from neuroanimator.files.atomic import write_whole
from neuroanimator.learn.evaluation import plots
from neuroanimator.learn.evaluation.machine import describe_machine
from neuroanimator.text import printable, short_number

TEMPLATES = Path(__file__).with_name("templates")
"""The folder of all templates."""

MARKDOWN_SIGNS = "\\`*[]<>|#!"
"""Characters that Markdown reads as markup or as the border of a cell."""


def write_page(path: str | Path, template: str, **values: Any) -> None:
    """Write a page that needs no other file: `template`, which extends `page.html`, filled with `values`."""
    made = {
        "time": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "version": version("neuroanimator"),
        "machine": describe_machine(),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
    }
    write_whole(Path(path), render(template, made=made, **values).encode())


def render(template: str, **values: Any) -> Markup:
    """Return the HTML of `template` filled with `values`; text other than `Markup` is escaped."""
    return Markup(_environment(as_text, True).get_template(template).render(values))


def render_markdown(template: str, **values: Any) -> str:
    """Return the Markdown of `template` filled with `values`; text other than `Markup` is escaped."""
    return _environment(as_markdown, False).get_template(template).render(values)


def as_text(value: object) -> object:
    """Return a value as a page shows it: numbers with three digits, text with unprintable characters escaped."""
    if isinstance(value, float):
        return short_number(value)
    if isinstance(value, str) and not isinstance(value, Markup):
        return printable(value)
    return value


def as_markdown(value: object) -> object:
    """Return a value that is safe in Markdown: no markup, no table, no line break."""
    if isinstance(value, Markup):
        return value
    plain = printable(str(as_text(value)))
    return "".join(f"\\{letter}" if letter in MARKDOWN_SIGNS else letter for letter in plain)


@cache
def _environment(finalize: Callable[[object], object], autoescape: bool) -> Environment:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=autoescape,
        undefined=StrictUndefined,
        finalize=finalize,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals["plots"] = plots
    environment.filters["printable"] = printable
    return environment
