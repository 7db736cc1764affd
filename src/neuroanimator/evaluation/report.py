"""`report.html`: one self-contained file with the figures, the plots and what they mean."""

from __future__ import annotations

import html
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from neuroanimator.emulator.verdict import beyond_noise
from neuroanimator.evaluation.bounded_errors import BoundedErrors
from neuroanimator.evaluation.evaluate import NO_OPPONENT, Evaluation
from neuroanimator.evaluation.page import glossary_html, made_html, table_html, write_page
from neuroanimator.evaluation.plots import EMULATOR, PHYSICS, QUIET, plot
from neuroanimator.evaluation.weakness.section import inspection_html
from neuroanimator.evaluation.work_precision import draw_work
from neuroanimator.text import printable

MAX_SHOWN = 3
"""Maximum number of state entries drawn of a motion."""

COLUMNS = {
    "system": "What is emulated.",
    "substeps": "Physics steps n in one super step of the emulator.",
    "one_step_error": "Root mean square error after one super step, in standard deviations of the change.",
    "noise_error": "The part of it that noise of the recordings makes alone; a perfect emulator would have it too.",
    "rollout_error_1s": "Error after a second, over how far runs get from their start.",
    "nominal_speedup": "Time of n physics steps at the system's own step, over that of one super step.",
    "equal_error_speedup": "The same against the fastest physics that is at least as accurate.",
    "equal_error_baseline": "That physics: its integrator and step.",
    "emulator_us": "Time of one super step [µs].",
    "emulator_jax_us": "The same in JAX [µs].",
    "physics_us": "Time of n physics steps at the system's own step [µs].",
    "diverged": "Random starts whose long rollouts went ten times further than training and physics do.",
    "verdict": "Useless: a guess that needs no emulator is as good. Good: controllers found through it hold on the physics.",
}
"""What each column of the table means."""

NOISE_CAPTION = (
    "What differs from sample to sample without belonging to a smooth motion is taken for noise. A perfect emulator would "
    "have the error that it makes by itself: noise of the state a step begins at, carried on, and of the state it is "
    "compared with. Squares add up: what is left to gain is the root of their difference."
)
"""What stands below the table of noise."""

BOUNDS_CAPTION = (
    "The bound of a usual motion: {level:.0%} of motions shall stay below theirs, which grow with the scores of trust on the "
    "way. Of these {runs} held-out runs {covered} did. Errors are over all that moves, in standard deviations of its usual "
    "change in a super step; controllers' motions have bounds of their own, as they go further astray."
)
"""What stands below the curve of errors and their bounds."""

TURNS_CAPTION = (
    "Where a super step's score of trust reaches the one on the left, the physics takes over for a few super steps and gives "
    "back. The error is that after 2 s, against fine physics from the same start, over how far runs get: "
    "na.hybrid_rollout, or animate --hybrid."
)
"""What stands below the table of turns."""


def write_report(
    evaluations: list[Evaluation], path: str | Path, *, extra: list[tuple[str, str]] | None = None
) -> None:
    """Write the report of `evaluations`; `extra` adds (title, HTML) sections before the details."""
    parts = [
        "<h1>NeuroAnimator: emulator against physics</h1>",
        made_html(),
        _table(evaluations),
        _glossary(evaluations),
        _verdict(evaluations),
    ]
    for title, body in extra or []:
        parts.append(f"<h2>{html.escape(title)}</h2>{body}")
    for evaluation in evaluations:
        parts.append(_section(evaluation))
    write_page(path, "NeuroAnimator report", parts)


def _table(evaluations: list[Evaluation]) -> str:
    rows = [evaluation.row() for evaluation in evaluations]
    lines = []
    # An emulator a column: a phone has room for one or two, and for all the figures below each other.
    for key in rows[0]:
        cells = "".join(f"<td>{_format(row[key])}</td>" for row in rows)
        lines.append(f"<tr><th>{html.escape(key.replace('_', ' '))}</th>{cells}</tr>")
    return f"<div class=wide><table>{''.join(lines)}</table></div>"


def _glossary(evaluations: list[Evaluation]) -> str:
    """Return what the columns of the table mean, to be unfolded."""
    meanings = {}
    for key in evaluations[0].row():
        meanings[key.replace("_", " ")] = COLUMNS.get(key, "")
    return glossary_html("What the columns mean", meanings)


def _format(value: str | int | float) -> str:
    return f"{value:.3g}" if isinstance(value, float) else html.escape(str(value))


def _verdict(evaluations: list[Evaluation]) -> str:
    return "".join(f"<p>{_sentence(evaluation)}</p>" for evaluation in evaluations)


def _sentence(evaluation: Evaluation) -> str:
    heading = f"<b>{_title(evaluation)}: {html.escape(str(evaluation.verdict))}.</b>"
    cost = f"One super step costs {evaluation.emulator_seconds * 1e6:.2f} µs"
    diverged = f"Diverged: {evaluation.diverged} of {evaluation.diverged_starts}"
    if evaluation.measured_speed is None:
        return f"{heading} {cost}. {NO_OPPONENT} {diverged} recorded starts."
    speed = evaluation.measured_speed
    return (
        f"{heading} {cost} in {html.escape(speed.runtime)}. "
        f"The physics' own {evaluation.substeps} steps take {speed.nominal:.0f} times as long. "
        f"{_at_equal_error(evaluation)} {diverged} random starts. {html.escape(evaluation.note)}"
    )


def _at_equal_error(evaluation: Evaluation) -> str:
    if evaluation.verdict.is_useless:
        return f"Speed-up at equal error: {html.escape(evaluation.equal_error_text)}."
    speed = evaluation.speed
    scheme = speed.equal_error_opponent.scheme
    word = "wins" if speed.equal_error > 1 else "loses"
    return (
        f"The fastest physics that is at least as accurate, {html.escape(scheme.integrator)} at "
        f"{scheme.dt * 1e3:.3g} ms, takes {speed.equal_error:.1f} times as long: at equal error the emulator {word}."
    )


def _title(evaluation: Evaluation) -> str:
    return f"{html.escape(evaluation.system)}, n = {evaluation.substeps}"


def _section(evaluation: Evaluation) -> str:
    is_recorded = evaluation.measured_speed is None
    body = ""
    figures = FIGURES
    if is_recorded:
        figures = RECORDED_FIGURES
    elif evaluation.is_own_reference:
        figures = OWN_FIGURES
    for draw, caption in figures:
        body += f"{plot(partial(draw, evaluation=evaluation))}<p>{caption}</p>"
    heading = f"<h2>{_title(evaluation)} (Δt = {evaluation.dt * 1e3:g} ms)</h2>"
    inspected = inspection_html(evaluation.inspection) if evaluation.inspection else ""
    known = f"{_bounds(evaluation)}{_turns(evaluation)}"
    return f"{heading}{body}{known}{_noise(evaluation)}{_cheap_predictors(evaluation)}{inspected}"


def _bounds(evaluation: Evaluation) -> str:
    """Return the curve of errors and their bounds, and whether these hold; empty without any."""
    bounded = evaluation.bounded
    if bounded is None:
        return ""
    drawn = plot(partial(_plot_bounds, bounded=bounded))
    caption = BOUNDS_CAPTION.format(level=bounded.level, runs=bounded.runs, covered=bounded)
    return f"<h3>How far rollouts go astray</h3>{drawn}<p>{caption}</p>"


def _plot_bounds(axes: Axes, bounded: BoundedErrors) -> None:
    axes.plot(bounded.times, bounded.bound, color=PHYSICS, label=f"bound of {bounded.level:.0%}")
    high = f"{bounded.level:.0%} of errors are below"
    axes.plot(bounded.times, bounded.high, color=EMULATOR, label=high)
    axes.plot(bounded.times, bounded.median, color=EMULATOR, ls=":", label="median error")
    axes.set(xlabel="time [s]", ylabel="error [usual changes]", yscale="log")
    axes.legend(frameon=False, fontsize=8)


def _turns(evaluation: Evaluation) -> str:
    """Return the table of motions in turns with the physics; empty where nobody looked."""
    if not evaluation.hybrid:
        return ""
    alone = evaluation.hybrid[0].emulator_error
    rows = []
    for share in evaluation.hybrid:
        gain = share.emulator_error / share.error if share.error else float("inf")
        rows.append((f"{share.threshold:g}", f"{share.physics_share:.0%}", share.error, gain))
    rows.append(("never", "0%", alone, 1.0))
    heads = ("physics from a score of", "its share of the time", "error at the end", "times less")
    table = _table_of(heads, rows)
    return f"<h3>In turns with the physics</h3>{table}<p>{TURNS_CAPTION}</p>"


def _noise(evaluation: Evaluation) -> str:
    """Return a table of the recordings' noise and what it makes of the error, number by number; empty without any."""
    if evaluation.noise is None or evaluation.noise_by_entry is None:
        return ""
    moving = [name not in evaluation.still for name in evaluation.entries]
    names = np.array(evaluation.entries)[moving]
    deviations = evaluation.noise[moving]
    figures = zip(
        names, deviations, evaluation.error_by_entry, evaluation.noise_by_entry, strict=True
    )
    rows = []
    for name, deviation, error, by_noise in figures:
        rows.append((name, deviation, error, by_noise, beyond_noise(error, by_noise)))
    noise = "noise [its unit]"
    by_itself = "by noise alone"
    heads = ("number of the state", noise, "one-step error", by_itself, "left to gain")
    table = _table_of(heads, rows)
    return f"<h3>Noise of the recordings</h3>{table}<p>{NOISE_CAPTION}</p>"


def _cheap_predictors(evaluation: Evaluation) -> str:
    if not evaluation.baselines:
        return ""
    table = _table_of(("predictor", "error"), list(evaluation.baselines.items()))
    return f"<h3>Cheap predictors, one-step error</h3>{table}"


def _table_of(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return rows of names and figures as a table."""
    shown = [[f"{cell:.3g}" if isinstance(cell, float) else cell for cell in row] for row in rows]
    return table_html([dict(zip(heads, row, strict=True)) for row in shown])


def _label(evaluation: Evaluation) -> str:
    """Return what the motion's axis says: the units of the entries drawn."""
    units = dict.fromkeys(entry.rsplit(" ", 1)[-1] for entry in evaluation.entries[:MAX_SHOWN])
    if list(units) == ["rad"]:
        return "joint angles [rad]"
    # Matplotlib reads what is between dollars as formulas.
    shown = printable(", ".join(units)).replace("$", r"\$")
    return f"state [{shown}]"


def _plot_motion(axes: Axes, evaluation: Evaluation) -> None:
    truth_name = "recorded" if evaluation.measured_speed is None else "physics"
    times = evaluation.times
    for entry, name in enumerate(evaluation.entries[:MAX_SHOWN]):
        truth = evaluation.sample_physics[:, entry]
        if name.endswith(" rad"):
            truth = np.unwrap(truth)
        emulated = evaluation.sample_emulated[:, entry]
        is_first = entry == 0
        axes.plot(times, truth, color=PHYSICS, label=truth_name if is_first else None)
        label = "emulator" if is_first else None
        axes.plot(times, emulated, "o", ms=3, color=EMULATOR, label=label)
    axes.set(xlabel="time [s]", ylabel=_label(evaluation))
    axes.legend(frameon=False)


def _plot_rollout(axes: Axes, evaluation: Evaluation) -> None:
    times = evaluation.times[1:]
    axes.plot(times, evaluation.rollout_errors[1:], color=EMULATOR, label="emulator")
    noise = evaluation.self_divergence
    if noise is not None and noise.any():
        axes.plot(times, noise[1:], color=QUIET, ls="--", label="physics at its own step")
    axes.set(xlabel="time [s]", ylabel="rollout error", yscale="log")
    axes.legend(frameon=False)


def _plot_work(axes: Axes, evaluation: Evaluation) -> None:
    draw_work(axes, [evaluation])
    axes.legend(frameon=False, fontsize=8)


FIGURES = [
    (_plot_motion, "A held-out run under random controls: fine physics and emulator."),
    (
        _plot_rollout,
        "Error in standard deviations of the state. The physics at its own default step strays from "
        "fine physics too; below that line nothing can be told apart.",
    ),
    (_plot_work, "Error against cost of one super step. Down and left is better."),
]
"""What is drawn of an emulator of physics: functions of the axes and the evaluation, and their captions."""

OWN_FIGURES = [
    (
        _plot_motion,
        "A held-out run under random controls: the physics at its own step and emulator.",
    ),
    (
        _plot_rollout,
        "Error in standard deviations of the state, against the physics at its own step: that is the truth here.",
    ),
    (_plot_work, "Error against cost of one super step. Down and left is better."),
]
"""What is drawn where the physics at its own step is the reference: a function that integrates no equation."""

RECORDED_FIGURES = [
    (_plot_motion, "A held-out recording, and the emulator under the same controls."),
    (_plot_rollout, "Error in standard deviations of the state."),
]
"""What is drawn of an emulator of recordings."""
