"""The worst cases of an emulator as curves: of every system, with or without bodies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroanimator.evaluation.plots import EMULATOR, PHYSICS, WIDTH
from neuroanimator.evaluation.worst_segments import Curve, Segment
from neuroanimator.text import printable

ROW_HEIGHT = 1.9
"""Height of a row of curves [inch]."""

SMALL = 8
"""Size of labels [points]."""

MARGIN = 0.1
"""What is left free above and below the physics and a sound emulator, over their range."""

MAX_OVER = 3.0
"""An emulator that leaves the physics' range by more than so many of it is drawn out of the picture."""


def draw_segments(segments: Sequence[Segment], truth_name: str = "physics") -> Figure:
    """Return a figure with a row for each segment: the numbers that are most wrong in it, by physics and emulator.

    `truth_name` is what the legend calls the physics.
    """
    count = len(segments[0].curves)
    size = (WIDTH, ROW_HEIGHT * len(segments))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(segments), count, squeeze=False)
    for row, segment in zip(panels, segments, strict=True):
        for axes, curve in zip(row, segment.curves, strict=True):
            _draw(axes, segment, curve, truth_name)
        row[0].set_title(
            f"run {segment.run + 1}, from {segment.start:.2g} s: error {segment.error:.2g}",
            fontsize=SMALL,
            loc="left",
        )
    for axes in panels[-1]:
        axes.set_xlabel("time [s]", fontsize=SMALL)
    panels[0, 0].legend(frameon=False, fontsize=SMALL)
    return figure


def _draw(axes: Axes, segment: Segment, curve: Curve, truth_name: str) -> None:
    """Draw one number of a segment."""
    times = segment.start + np.arange(len(curve.physics)) * segment.dt
    axes.plot(times, curve.physics, color=PHYSICS, lw=1.2, label=truth_name)
    axes.plot(times, curve.emulated, "o-", color=EMULATOR, ms=2, lw=0.6, label="emulator")
    # Matplotlib reads what is between dollars as formulas.
    label = printable(f"{curve.name} [{curve.unit}]").replace("$", r"\$")
    axes.set_ylabel(label, fontsize=SMALL)
    axes.set_ylim(*_limits(curve.physics, curve.emulated))
    axes.tick_params(labelsize=SMALL)


def _limits(physics: np.ndarray, emulated: np.ndarray) -> tuple[float, float]:
    """Return the ends of the vertical axis: all of the physics, and of the emulator what is not far away."""
    low = float(physics.min())
    high = float(physics.max())
    reach = MAX_OVER * max(high - low, 1e-9)
    sound = emulated[np.isfinite(emulated)]
    low = max(float(sound.min(initial=low)), low - reach)
    high = min(float(sound.max(initial=high)), high + reach)
    room = MARGIN * max(high - low, 1e-9)
    return low - room, high + room
