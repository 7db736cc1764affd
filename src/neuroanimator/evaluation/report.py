"""`report.html`: one self-contained file with the figures, the plots and what they mean."""

from __future__ import annotations

import html
import io
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neuroanimator.evaluation.evaluate import NO_OPPONENT, Evaluation
from neuroanimator.evaluation.work_precision import EMULATOR, draw_work
from neuroanimator.storage.files import write_whole
from neuroanimator.text import printable

SHOWN = 3
"""State entries drawn of a motion, at most."""

PHYSICS, QUIET = "#2b5a94", "#8a94a0"

STYLE = """body{font:16px/1.55 system-ui,sans-serif;color:#1c2733;max-width:62rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.6rem}h2{margin-top:2.2rem;font-size:1.2rem}table{border-collapse:collapse;margin:1rem 0}
td,th{padding:.3rem .8rem;border-bottom:1px solid #dde3ea;text-align:right}
td:first-child,th:first-child{text-align:left}
svg{max-width:100%;height:auto}p{max-width:46rem}"""


def write_report(
    evaluations: list[Evaluation], path: Path, *, extra: list[tuple[str, str]] | None = None
) -> None:
    """Write the report of `evaluations`; `extra` adds (title, HTML) sections before the details."""
    parts = [
        "<h1>NeuroAnimator: emulator against physics</h1>",
        _table(evaluations),
        _verdict(evaluations),
    ]
    parts += [f"<h2>{html.escape(title)}</h2>{body}" for title, body in extra or []]
    for evaluation in evaluations:
        parts.append(_section(evaluation))
    page = f"<!doctype html><html lang=en><meta charset=utf-8><title>NeuroAnimator report</title><style>{STYLE}</style>"
    write_whole(path, (page + "".join(parts) + "</html>\n").encode())


def _table(evaluations: list[Evaluation]) -> str:
    rows = [evaluation.row() for evaluation in evaluations]
    head = "".join(f"<th>{html.escape(key.replace('_', ' '))}</th>" for key in rows[0])

    def cells(row):
        return "".join(f"<td>{_format(value)}</td>" for value in row.values())

    return (
        f"<table><tr>{head}</tr>" + "".join(f"<tr>{cells(row)}</tr>" for row in rows) + "</table>"
    )


def _format(value: str | int | float) -> str:
    return f"{value:.3g}" if isinstance(value, float) else html.escape(str(value))


def _verdict(evaluations: list[Evaluation]) -> str:
    return "".join(f"<p>{_sentence(evaluation)}</p>" for evaluation in evaluations)


def _sentence(e: Evaluation) -> str:
    if e.measured_speed is None:
        return (
            f"{_heading(e)} One super step costs {e.emulator_seconds * 1e6:.2f} µs. "
            f"{NO_OPPONENT} Blow-ups: {e.diverged} of {e.diverged_starts} recorded starts."
        )
    speed = e.speed
    return (
        f"{_heading(e)} One super step costs {speed.emulator_seconds * 1e6:.2f} µs "
        f"in {html.escape(speed.runtime)}. "
        f"The physics' own {e.substeps} steps take {speed.nominal:.0f} times as long. {_at_equal_error(e)} "
        f"Blow-ups: {e.diverged} of {e.diverged_starts} random starts. {html.escape(e.note)}"
    )


def _heading(e: Evaluation) -> str:
    return f"<b>{_title(e)}: {html.escape(str(e.verdict))}.</b>"


def _at_equal_error(e: Evaluation) -> str:
    if e.verdict.is_useless:
        return f"Speed-up at equal error: {html.escape(e.equal_error_text)}."
    speed = e.speed
    rival = speed.rival.scheme
    word = "wins" if speed.equal_error > 1 else "loses"
    return (
        f"The fastest physics that is at least as accurate, {html.escape(rival.integrator)} at "
        f"{rival.dt * 1e3:.3g} ms, takes {speed.equal_error:.1f} times as long: at equal error the emulator {word}."
    )


def _title(e: Evaluation) -> str:
    return f"{html.escape(e.system)}, n = {e.substeps}"


def _section(e: Evaluation) -> str:
    figures = RECORDED_FIGURES if e.measured_speed is None else FIGURES
    body = "".join(f"{plot(partial(draw, e=e))}<p>{caption}</p>" for draw, caption in figures)
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{error:.3g}</td></tr>"
        for name, error in e.baselines.items()
    )
    cheap = f"<h3>Cheap predictors, one-step error</h3><table>{rows}</table>" if rows else ""
    return f"<h2>{_title(e)} (Δt = {e.dt * 1e3:g} ms)</h2>{body}{cheap}"


def _label(e: Evaluation) -> str:
    units = dict.fromkeys(entry.rsplit(" ", 1)[-1] for entry in e.entries[:SHOWN])
    if list(units) == ["rad"]:
        return "joint angles [rad]"
    shown = printable(", ".join(units)).replace(
        "$", r"\$"
    )  # Matplotlib reads what is between dollars as formulas
    return f"state [{shown}]"


def plot(draw: Callable[[Axes], None]) -> str:
    """Return what `draw` draws, as inline SVG with the same bytes every time."""
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    draw(figure.add_subplot())
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def _truth_name(e: Evaluation) -> str:
    return "recorded" if e.measured_speed is None else "physics"


def _plot_motion(axes: Axes, e: Evaluation) -> None:
    for entry in range(min(SHOWN, len(e.entries))):
        truth = e.sample_physics[:, entry]
        axes.plot(
            e.times,
            np.unwrap(truth) if e.entries[entry].endswith(" rad") else truth,
            color=PHYSICS,
            label=_truth_name(e) if entry == 0 else None,
        )
        axes.plot(
            e.times,
            e.sample_emulated[:, entry],
            "o",
            ms=3,
            color=EMULATOR,
            label="emulator" if entry == 0 else None,
        )
    axes.set(xlabel="time [s]", ylabel=_label(e))
    axes.legend(frameon=False)


def _plot_rollout(axes: Axes, e: Evaluation) -> None:
    axes.plot(e.times[1:], e.rollout_errors[1:], color=EMULATOR, label="emulator")
    if e.self_divergence is not None and e.self_divergence.any():
        axes.plot(
            e.times[1:],
            e.self_divergence[1:],
            color=QUIET,
            ls="--",
            label="physics at its own step",
        )
    axes.set(xlabel="time [s]", ylabel="rollout error", yscale="log")
    axes.legend(frameon=False)


def _plot_work(axes: Axes, e: Evaluation) -> None:
    draw_work(axes, [e])
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
RECORDED_FIGURES = [
    (_plot_motion, "A held-out recording, and the emulator under the same controls."),
    (_plot_rollout, "Error in standard deviations of the state."),
]
