"""The races as a picture: J on the true physics over time and over physics steps."""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

from neuroanimator.bench.baselines.race import Race
from neuroanimator.control.synthesis.synthesise import Synthesis
from neuroanimator.storage.files import write_whole

WIDTH, HEIGHT = 11.0, 1.9
"""[in] Of the picture, and of each task in it."""
COLOURS = {"annealing": "#2b5a94", "cma-es": "#e8892b", "ilqr": "#4fa3a0", "nelder-mead": "#7a4f9a"}


class Panel(NamedTuple):
    """What is drawn of a task."""

    task: str
    found: Synthesis
    seconds: float
    """What the emulator's way took."""
    races: list[Race]


def draw_races(panels: list[Panel], path: Path) -> None:
    """Draw for each task how J fell in its first race: rivals as curves, the emulator as a star."""
    figure = Figure(figsize=(WIDTH, HEIGHT * len(panels)), layout="constrained")
    axes = figure.subplots(len(panels), 2, squeeze=False)
    for (by_time, by_steps), each in zip(axes, panels, strict=True):
        for found in each.races:
            costs = [point.cost for point in found.curve]
            line = {"where": "post", "color": COLOURS[found.name]}
            by_time.step([point.seconds for point in found.curve], costs, label=found.name, **line)
            by_steps.step([point.physics_steps for point in found.curve], costs, **line)
        own = each.found
        by_time.plot(each.seconds, own.outcome.cost_physics, "k*", markersize=11, label="emulator")
        by_steps.plot(own.physics_steps, own.outcome.cost_physics, "k*", markersize=11)
        by_time.set_ylabel(f"{each.task}\nJ on the physics")
        for axis in (by_time, by_steps):
            axis.set_xscale("log")
            axis.set_yscale("log")
    axes[-1, 0].set_xlabel("seconds, compiling excluded")
    axes[-1, 1].set_xlabel("physics steps")
    axes[0, 0].legend(fontsize="small")
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=110)
    write_whole(path, picture.getvalue())
