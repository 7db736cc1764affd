"""A line of text as a picture: the caption of a take."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from neuroanimator.evaluation.plots import label

LINE_SHARE = 0.055
"""Height of the caption, over the picture's."""

LETTER_SHARE = 0.62
"""Size of the letters, over the caption's height."""

MARGIN = 0.02
"""What is left free on both sides, over the picture's width: longer captions get smaller letters."""

POINTS = 72.0
"""Points in an inch, in which letters are measured."""

SMALLER = 0.93
"""Factor by which letters are made smaller until they fit."""

MAX_LETTERS = 160
"""Letters of a caption that are shown: nobody reads more in a second or two."""

PAPER = "#14191f"
"""The colour behind the letters."""

INK = "#dbe3ec"
"""The colour of the letters."""


def caption_image(text: str, size: tuple[int, int]) -> UInt8[np.ndarray, "H W 3"]:
    """Return the caption `text` of a picture of `size` [pixels]; no rows where there is no text."""
    width, height = size
    if not text:
        return np.zeros((0, width, 3), np.uint8)
    rows = max(round(LINE_SHARE * height), 2)
    figure = Figure(figsize=(width / POINTS, rows / POINTS), dpi=POINTS, facecolor=PAPER)
    canvas = FigureCanvasAgg(figure)
    line = label(text[:MAX_LETTERS])
    written = figure.text(0.5, 0.5, line, ha="center", va="center", color=INK)
    letters = LETTER_SHARE * rows
    written.set_fontsize(letters)
    renderer = canvas.get_renderer()
    while written.get_window_extent(renderer).width > (1 - 2 * MARGIN) * width and letters > 1:
        letters *= SMALLER
        written.set_fontsize(letters)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]
