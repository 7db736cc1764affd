"""Rows below a picture: a caption, and the curve of the emulator's trust score."""

from __future__ import annotations

from typing import final

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.trust import EDGE
from neuroanimator.film.options import Picture, Take
from neuroanimator.learn.evaluation.plots import label

CAPTION_SHARE = 0.055
"""Height of the caption, over the picture's."""

CURVE_SHARE = 0.09
"""Height of the curve, over the picture's."""

CAPTION_LETTERS = 0.62
"""Font size of the caption, over its height, if it fits."""

CURVE_LETTERS = 0.3
"""Font size of the curve, over its height."""

MARGIN = 0.02
"""Free space on both sides of a caption, over the picture's width."""

SMALLER = 0.93
"""Factor by which the font is made smaller until the text fits."""

MAX_LETTERS = 160
"""Maximum number of characters of a caption: more cannot be read in a second or two."""

POINTS = 72.0
"""Number of points per inch, the unit of font sizes."""

PAPER = "#14191f"
INK = "#dbe3ec"
CURVE = "#7cc4ff"
DOUBT = "#ff8a1f"

MAX_SCORE = 3.0
"""Score above which the curve is drawn at the top."""

MIN_TOP = 1.5
"""Minimum score at the top of the curve, so that the edge is visible."""


@final
class Footer:
    """The lowest rows of a take's pictures; none if there is nothing to show."""

    def __init__(self, take: Take, size: tuple[int, int]):
        """Draw it for pictures of `size` (width, height) [pixels]."""
        width, height = size
        clip = take.clips[0]
        self._last = len(clip.times) - 1
        self._curve = np.zeros((0, width, 3), np.uint8)
        self._caption = self._curve
        if clip.trust is not None:
            self._curve = _curve_image(clip, clip.trust, width, max(round(CURVE_SHARE * height), 8))
        if take.caption:
            rows = max(round(CAPTION_SHARE * height), 2)
            self._caption = caption_image(take.caption, width, rows)

    def write(self, image: Picture, frame: int) -> None:
        """Write it into the image of `frame`, with a line at the current time of the curve."""
        below = np.concatenate([self._curve, self._caption])
        done = min(frame / max(self._last, 1), 1.0)
        column = round(done * (image.shape[1] - 2))
        below[: len(self._curve), column : column + 2] = 255
        image[len(image) - len(below) :] = below


def caption_image(text: str, width: int, rows: int) -> Picture:
    """Return a line of text in a font small enough to fit."""
    canvas = _canvas(width, rows)
    letters = CAPTION_LETTERS * rows
    written = canvas.figure.text(
        0.5, 0.5, label(text[:MAX_LETTERS]), ha="center", va="center", color=INK, size=letters
    )
    renderer = canvas.get_renderer()
    while written.get_window_extent(renderer).width > (1 - 2 * MARGIN) * width and letters > 1:
        letters *= SMALLER
        written.set_fontsize(letters)
    return _pixels(canvas)


def _curve_image(clip: Clip, scores: Float[np.ndarray, " F"], width: int, rows: int) -> Picture:
    """Return the curve of the scores over time, red where they are beyond the edge of training."""
    canvas = _canvas(width, rows)
    axes = canvas.figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    top = float(np.clip(scores.max() * 1.1, MIN_TOP, MAX_SCORE))
    shown = np.minimum(scores, top)
    frames = np.arange(len(scores))
    axes.set(xlim=(0, len(scores) - 1), ylim=(0, top * 1.05))
    axes.fill_between(frames, EDGE, shown, where=shown > EDGE, color=DOUBT, alpha=0.6, step="pre")
    axes.plot(frames, shown, color=CURVE, lw=max(rows / 40, 1), drawstyle="steps-pre")
    axes.axhline(EDGE, color=DOUBT, lw=max(rows / 60, 0.8), ls="--")
    words = "trust: 1 (dashed) is the edge of training"
    if clip.verdict:
        words += f"; the emulator there: {clip.verdict}"
    canvas.figure.text(0.01, 0.92, words, color=INK, size=CURVE_LETTERS * rows, va="top")
    return _pixels(canvas)


def _canvas(width: int, rows: int) -> FigureCanvasAgg:
    size = (width / POINTS, rows / POINTS)
    return FigureCanvasAgg(Figure(figsize=size, dpi=POINTS, facecolor=PAPER))


def _pixels(canvas: FigureCanvasAgg) -> Picture:
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]
