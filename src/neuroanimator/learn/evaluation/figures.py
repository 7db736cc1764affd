"""The figures of reports: functions of the axes to draw on, and of what was measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroanimator.emulator.trust import EDGE
from neuroanimator.learn.evaluation.bounded_errors import BoundedErrors
from neuroanimator.learn.evaluation.component_errors import ErrorSpread
from neuroanimator.learn.evaluation.evaluate import Evaluation
from neuroanimator.learn.evaluation.plots import EMULATOR, PHYSICS, QUIET, WIDTH, label
from neuroanimator.learn.evaluation.speed import Speed
from neuroanimator.learn.evaluation.speed_function import PYTHON_FUNCTION
from neuroanimator.learn.evaluation.trust_bands import TrustBand
from neuroanimator.learn.evaluation.weakness.worst_segments import Curve, WorstSegment
from neuroanimator.learn.training.train import Report

MAX_SHOWN = 3
"""Maximum number of state entries of a motion that are drawn."""

ROW_HEIGHT = 1.9
"""Height of a row of curves [inch]."""

SMALL = 8
"""Size of the labels in a figure of many panels [points]."""

MARGIN = 0.1
"""Room above and below the physics and a sound emulator, over their range."""

MAX_OVER = 3.0
"""Distance from the physics' range, over that range, beyond which an emulator's curve leaves the picture."""

COLOURS = {
    "euler": "#2b5a94",
    "symplectic": "#2b5a94",
    "implicitfast": "#4fa3a0",
    "semi-implicit": "#4fa3a0",
    "implicit": "#8a94a0",
    "rk4": "#7a4f9a",
    "discrete": "#c2703d",
}
"""Colour of each integrator; similar ones of MuJoCo and of mass-spring bodies share one."""

MIN_ERROR = 1e-6
"""Error below which a scheme is not drawn: it is the reference itself."""

MAX_ERROR = 2.0
"""Error above which a scheme is not drawn: it diverges."""


def draw_motion(axes: Axes, evaluation: Evaluation) -> None:
    """Draw the first numbers of the state along one unseen run."""
    truth_name = "recorded" if evaluation.measured_speed is None else "physics"
    times = evaluation.times
    for entry, name in enumerate(evaluation.entries[:MAX_SHOWN]):
        truth = evaluation.sample_physics[:, entry]
        if name.endswith(" rad"):
            truth = np.unwrap(truth)
        axes.plot(times, truth, color=PHYSICS)
        axes.plot(times, evaluation.sample_emulated[:, entry], "o", ms=3, color=EMULATOR)
    axes.lines[0].set_label(truth_name)
    axes.lines[1].set_label("emulator")
    axes.set(xlabel="time [s]", ylabel=_motion_label(evaluation))


def _motion_label(evaluation: Evaluation) -> str:
    """Return the label of the motion's axis: the units of the entries drawn."""
    units = dict.fromkeys(entry.rsplit(" ", 1)[-1] for entry in evaluation.entries[:MAX_SHOWN])
    if list(units) == ["rad"]:
        return "joint angles [rad]"
    return f"state [{label(', '.join(units))}]"


def draw_rollout_errors(axes: Axes, evaluation: Evaluation) -> None:
    """Draw the growth of errors along unseen runs, above the physics' divergence from itself."""
    times = evaluation.times[1:]
    axes.plot(times, evaluation.rollout_errors[1:], color=EMULATOR, label="emulator")
    noise = evaluation.self_divergence
    if noise is not None and noise.any():
        axes.plot(times, noise[1:], color=QUIET, ls="--", label="physics at its own step")
    axes.set(xlabel="time [s]", ylabel="rollout error", yscale="log")


def draw_bounds(axes: Axes, bounded: BoundedErrors) -> None:
    """Draw errors along unseen runs and their predicted bounds."""
    axes.plot(bounded.times, bounded.bound, color=PHYSICS, label=f"bound of {bounded.level:.0%}")
    high = f"{bounded.level:.0%} of errors are below"
    axes.plot(bounded.times, bounded.high, color=EMULATOR, label=high)
    axes.plot(bounded.times, bounded.median, color=EMULATOR, ls=":", label="median error")
    axes.set(xlabel="time [s]", ylabel="error [usual changes]", yscale="log")


def draw_error_spread(axes: Axes, spread: ErrorSpread) -> None:
    """Draw the histogram of one-step errors with its median, its 95 % and its worst."""
    axes.stairs(spread.counts, spread.edges, fill=True, color=EMULATOR)
    marks = [
        ("median", spread.median, "-"),
        ("95 %", spread.high, "--"),
        ("worst", spread.worst, ":"),
    ]
    for name, value, style in marks:
        if 0 < value < np.inf:
            axes.axvline(value, color=PHYSICS, ls=style, lw=1.2, label=f"{name}: {value:.2g}")
    axes.set(
        xlabel="one-step error [standard deviations of the change]",
        ylabel="super steps",
        xscale="log",
    )


def draw_trust(axes: Axes, bands: Sequence[TrustBand]) -> None:
    """Draw median and large errors against the trust score."""
    middles = [band.middle for band in bands]
    axes.plot(middles, [band.median for band in bands], "o-", color=EMULATOR, label="median")
    large = [band.large for band in bands]
    axes.plot(middles, large, "o--", color=QUIET, label="95 % are below")
    axes.axvline(EDGE, color=PHYSICS, ls=":", lw=1.2, label="edge of training")
    axes.set(
        xlabel="trust: score of a super step",
        ylabel="one-step error [standard deviations]",
        xscale="log",
        yscale="log",
    )


def draw_segments(segments: Sequence[WorstSegment], truth_name: str = "physics") -> Figure:
    """Return a figure with a row for each segment: the most erroneous numbers in it, by physics and emulator.

    `truth_name` is what the legend calls the physics.
    """
    size = (WIDTH, ROW_HEIGHT * len(segments))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(segments), len(segments[0].curves), squeeze=False)
    for row, segment in zip(panels, segments, strict=True):
        times = segment.start + np.arange(len(segment.physics)) * segment.dt
        for axes, curve in zip(row, segment.curves, strict=True):
            axes.plot(times, curve.physics, color=PHYSICS, lw=1.2, label=truth_name)
            axes.plot(times, curve.emulated, "o-", color=EMULATOR, ms=2, lw=0.6, label="emulator")
            axes.set_ylabel(label(f"{curve.name} [{curve.unit}]"), fontsize=SMALL)
            axes.set_ylim(*_limits(curve))
            axes.tick_params(labelsize=SMALL)
        title = f"run {segment.run + 1}, from {segment.start:.2g} s: error {segment.error:.2g}"
        row[0].set_title(title, fontsize=SMALL, loc="left")
    for axes in panels[-1]:
        axes.set_xlabel("time [s]", fontsize=SMALL)
    panels[0, 0].legend(frameon=False, fontsize=SMALL)
    return figure


def _limits(curve: Curve) -> tuple[float, float]:
    """Return the ends of the vertical axis: all of the physics, and the emulator where it is not far away."""
    low = curve.physics.min()
    high = curve.physics.max()
    reach = MAX_OVER * max(high - low, 1e-9)
    sound = curve.emulated[np.isfinite(curve.emulated)]
    drawn = [*curve.physics, *np.clip(sound, low - reach, high + reach)]
    room = MARGIN * max(max(drawn) - min(drawn), 1e-9)
    return min(drawn) - room, max(drawn) + room


def draw_work(axes: Axes, evaluations: Sequence[Evaluation]) -> None:
    """Draw error against cost: the physics' schemes as timed in the first evaluation, and a star for each emulator."""
    speed = evaluations[0].speed
    for integrator in sorted({opponent.scheme.integrator for opponent in speed.opponents}):
        _draw_integrator(axes, speed, integrator)
    costs = [evaluation.emulator_seconds * 1e6 for evaluation in evaluations]
    errors = [evaluation.one_step_error for evaluation in evaluations]
    axes.plot(costs, errors, "*", ms=12, color=EMULATOR, label="emulator")
    axes.set(
        xlabel="cost of one super step [µs]", ylabel="one-step error", xscale="log", yscale="log"
    )


def _draw_integrator(axes: Axes, speed: Speed, integrator: str) -> None:
    """Draw one integrator's steps, from the cheapest on, as a line."""
    points = []
    for opponent in speed.opponents:
        is_drawn = MIN_ERROR < opponent.error < MAX_ERROR
        if opponent.scheme.integrator == integrator and is_drawn:
            points.append((opponent.seconds * 1e6, opponent.error))
    line = np.array(sorted(points)).reshape(-1, 2)
    name = speed.physics
    if speed.physics != PYTHON_FUNCTION:
        name = f"{speed.physics} {integrator}"
    colour = COLOURS.get(integrator)
    axes.plot(line[:, 0], line[:, 1], "o-", ms=3, lw=0.8, color=colour, label=name)


def draw_training(axes: Axes, reports: Sequence[Report]) -> None:
    """Draw loss and errors against updates."""
    updates = [report.update for report in reports]
    errors = [report.error for report in reports]
    axes.plot(updates, errors, color=EMULATOR, label="error after one super step")
    unrolled = [report.unrolled_error for report in reports]
    axes.plot(updates, unrolled, color=EMULATOR, ls="--", label="error after the longest unroll")
    losses = [report.loss for report in reports]
    axes.plot(updates, losses, color=QUIET, lw=1, label="loss")
    axes.set(xlabel="update", ylabel="error, loss", yscale="log")
