"""How far to believe a motion, in its film: the body's glow, and a curve below the picture."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.trust import EDGE
from neuroanimator.export.film.caption import INK, PAPER, POINTS

GLOW = (1.0, 0.54, 0.12)
"""The colour of doubt, red green blue, as on the studio's stage."""

LOST = 3.0
"""Mean score at which a body has the colour of doubt all over, as on the studio's stage."""

MOST = 0.7
"""Share of the colour of doubt at most: what it is a picture of is still to be seen."""

EMISSION = 0.2
"""Light of its own that a body in doubt has at most."""

SMOOTHED = 0.3
"""Time over which scores are averaged before they colour a body [s]: one that flickers is looked away from."""

STRIP_SHARE = 0.09
"""Height of the curve, over the picture's."""

LETTER_SHARE = 0.3
"""Size of its letters, over its height."""

CURVE = "#7cc4ff"
DOUBT = "#ff8a1f"

TOP_SCORE = 3.0
"""Scores beyond this are drawn at the top."""

LEAST_TOP = 1.5
"""The curve reaches up to this at least, so that its edge is seen."""


def doubts(clip: Clip, frames: int) -> Float[np.ndarray, " F"]:
    """Return how much of the colour of doubt its body has in each of `frames`, 0 to 1; none where trust is not shown."""
    if clip.trust is None:
        return np.zeros(frames)
    scores = np.minimum(clip.trust, 2 * LOST)
    width = max(round(SMOOTHED * clip.rate), 1)
    past = np.concatenate([np.full(width - 1, scores[0]), scores])
    smooth = np.convolve(past, np.full(width, 1 / width), mode="valid")
    held = smooth[np.minimum(np.arange(frames), len(smooth) - 1)]
    return np.clip((held - EDGE) / (LOST - EDGE), 0, 1)


def glow(
    scene: mujoco.MjvScene,
    owners: dict[int, Int[np.ndarray, " N"]],
    shares: Float[np.ndarray, " K"],
) -> None:
    """Mix the colour of doubt into what belongs to each clip, by its share.

    `owners` says for each kind of object (MuJoCo's mjtObj), by number, of which clip it is: -1 for none.
    """
    if not shares.any():
        return
    for number in range(scene.ngeom):
        geom = scene.geoms[number]
        owner = owners.get(geom.objtype)
        if owner is None or geom.objid < 0 or owner[geom.objid] < 0:
            continue
        share = MOST * shares[owner[geom.objid]]
        if share > 0:
            geom.rgba[:3] = (1 - share) * geom.rgba[:3] + share * np.array(GLOW)
            geom.emission = max(geom.emission, EMISSION * share)


class TrustStrip:
    """The curve of scores below a picture, with a line where the film is; no rows where trust is not shown."""

    def __init__(self, clip: Clip, size: tuple[int, int]):
        """Draw the curve for pictures of `size` (width, height) [pixels]."""
        width, height = size
        self._frames = len(clip.times)
        if clip.trust is None:
            self._image = np.zeros((0, width, 3), np.uint8)
            return
        rows = max(round(STRIP_SHARE * height), 8)
        figure = Figure(figsize=(width / POINTS, rows / POINTS), dpi=POINTS, facecolor=PAPER)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        top = float(np.clip(clip.trust.max() * 1.1, LEAST_TOP, TOP_SCORE))
        shown = np.minimum(clip.trust, top)
        frames = np.arange(self._frames)
        axes.set(xlim=(0, self._frames - 1), ylim=(0, top * 1.05))
        axes.fill_between(
            frames, EDGE, shown, where=shown > EDGE, color=DOUBT, alpha=0.6, step="pre"
        )
        axes.plot(frames, shown, color=CURVE, lw=max(rows / 40, 1), drawstyle="steps-pre")
        axes.axhline(EDGE, color=DOUBT, lw=max(rows / 60, 0.8), ls="--")
        letters = LETTER_SHARE * rows
        words = "trust: 1 (dashed) is the edge of training"
        if clip.verdict:
            words += f"; the emulator there: {clip.verdict}"
        axes.text(
            0.01,
            0.92,
            words,
            color=INK,
            size=letters,
            transform=axes.transAxes,
            va="top",
        )
        canvas.draw()
        self._image = np.array(canvas.buffer_rgba())[..., :3]

    def __len__(self) -> int:
        return len(self._image)

    def at(self, frame: int) -> UInt8[np.ndarray, "H W 3"]:
        """Return the strip of `frame`."""
        image = self._image.copy()
        if len(image):
            width = image.shape[1]
            place = round(min(frame, self._frames - 1) / max(self._frames - 1, 1) * (width - 2))
            image[:, place : place + 2] = 255
        return image
