"""Plots as text: inline SVG, with the same bytes every time."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence

from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from neuroanimator.text import printable

EMULATOR = "#e8892b"
"""Colour of the emulator in all plots."""

PHYSICS = "#2b5a94"
"""Colour of the physics in all plots."""

QUIET = "#8a94a0"
"""Colour of what is drawn for comparison."""

WIDTH = 8.0
"""Width of several plots side by side [inch]."""

ALONE = (5.4, 3.0)
"""Width and height of a single plot [inch]: its text can be read on a phone, too."""

SALT = "neuroanimator"
"""Salt of the ids in SVG, which would otherwise be random."""

BAR_HEIGHT = 16
"""Height of the highest bar of a small histogram, over the width of a bar."""


def plot(draw: Callable[..., None], *subjects: object) -> Markup:
    """Return the drawing that `draw(axes, *subjects)` makes, as inline SVG."""
    figure = Figure(figsize=ALONE, layout="constrained")
    axes = figure.add_subplot()
    draw(axes, *subjects)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=9)
    return inline_svg(figure)


def inline_svg(figure: Figure) -> Markup:
    """Return a figure as inline SVG for a page."""
    text = svg_text(figure)
    return Markup(text[text.index("<svg") :].replace("<svg", "<svg class=plot", 1))


def label(text: str) -> str:
    """Return foreign text so that Matplotlib shows it unchanged: it reads text between dollars as formulas."""
    return printable(text).replace("$", r"\$")


def svg_text(figure: Figure) -> str:
    """Return a figure as the text of an SVG file: the same every time, without a date and with ids made from contents."""
    buffer = io.StringIO()
    with rc_context({"svg.hashsalt": SALT}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def small_bars(counts: Sequence[float]) -> Markup:
    """Return a small histogram as inline SVG, without axes, in the colour of the page's bars."""
    most = max(counts, default=0) or 1
    bars = []
    for number, count in enumerate(counts):
        if count <= 0:
            continue
        height = max(BAR_HEIGHT * 10 * count / most, 2)  # one in thousands is visible, too
        top = BAR_HEIGHT * 10 - height
        bars.append(f"M{10 * number} {top:.0f}h9v{height:.0f}h-9z")
    box = f"0 0 {10 * len(counts)} {BAR_HEIGHT * 10}"
    return Markup(
        f'<svg class=bars viewBox="{box}" preserveAspectRatio="none"><path d="{"".join(bars)}"/></svg>'
    )
