"""The report of a controller as one page: its motion on the physics, J over the descent, and its controls."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np
from jaxtyping import Float
from markupsafe import Markup
from matplotlib.axes import Axes

from neuroanimator.control.synthesis.summary import outcome_rows
from neuroanimator.control.synthesis.synthesise import Synthesis
from neuroanimator.film.inline import replay_html
from neuroanimator.learn.evaluation.held_out import replayable_system
from neuroanimator.learn.evaluation.page import render, write_page
from neuroanimator.learn.evaluation.plots import EMULATOR, PHYSICS, QUIET, label
from neuroanimator.learn.evaluation.weakness.readings import state_readings
from neuroanimator.state.layout import entry_names, entry_units
from neuroanimator.state.rotation import wrapped
from neuroanimator.terminal import TableRows

MAX_CURVES = 6
"""Maximum number of controls of a unit in a plot, and of readings in the table of the emulator's largest errors."""


def write_control_report(
    synthesis: Synthesis, path: str | Path, *, asked: Sequence[tuple[str, object]] = ()
) -> None:
    """Write the report of `synthesis` as one page that needs no other file; `asked` adds rows to the head of its table.

    Where nothing can be drawn, the page says so in place of the film.
    """
    film = replay_html(synthesis.emulator, synthesis.outcome)
    body = control_html(synthesis, film, asked=asked)
    write_page(path, "controller.html", system=synthesis.emulator.system, body=body)


def control_html(
    synthesis: Synthesis, film: Markup, *, asked: Sequence[tuple[str, object]] = ()
) -> Markup:
    """Return the outcome of `synthesis`, how its controls were found, and the emulator's accuracy along the motion."""
    units = entry_units(synthesis.emulator.control)
    entries_by_unit: dict[str, list[int]] = {}
    for entry, unit in enumerate(units):
        entries_by_unit.setdefault(unit, []).append(entry)
    return render(
        "control.html",
        rows=[*asked, *outcome_rows(synthesis)],
        film=film,
        synthesis=synthesis,
        controls_by_unit=list(entries_by_unit.values()),
        strayed=_strayed_rows(synthesis),
        draw_costs=_draw_costs,
        draw_controls=_draw_controls,
    )


def _draw_costs(axes: Axes, synthesis: Synthesis) -> None:
    """Draw J on the emulator over the iterations of all descents, one after another."""
    before = 0
    for number, course in enumerate(synthesis.spent.courses):
        iterations = before + np.arange(len(course))
        label = "on the emulator" if number == 0 else None
        axes.plot(iterations, course, "o-", ms=2.5, lw=1.2, color=EMULATOR, label=label)
        before += len(course) - 1
    outcome = synthesis.outcome
    if outcome.is_on_physics:
        axes.axhline(outcome.cost_physics, color=PHYSICS, ls="--", lw=1.2, label="on the physics")
    axes.set(xlabel="iteration", ylabel="J")
    if all(cost > 0 for course in synthesis.spent.courses for cost in course):
        axes.set_yscale("log")


def _liveliest(rows: Float[np.ndarray, "T C"], entries: Sequence[int]) -> list[int]:
    """Return the `entries` with the largest ranges in `rows`, in their own order."""
    ranges = np.ptp(rows[:, entries], axis=0)
    first = np.argsort(-ranges, kind="stable")[:MAX_CURVES]
    return [entries[number] for number in sorted(first)]


def _draw_controls(axes: Axes, synthesis: Synthesis, among: Sequence[int]) -> None:
    """Draw the controls that change most `among` those of one unit."""
    emulator = synthesis.emulator
    names = entry_names(emulator.control)
    controls = synthesis.controls
    entries = _liveliest(controls, among)
    # Held until the end of the last super step.
    times = np.arange(len(controls) + 1) * emulator.dt
    for entry in entries:
        held = np.append(controls[:, entry], controls[-1:, entry])
        axes.step(times, held, where="post", lw=1.2, label=label(names[entry]))
    bounds = np.array([emulator.bounds.low, emulator.bounds.high])
    for limit in np.unique(bounds[:, entries]):
        axes.axhline(limit, color=QUIET, ls=":", lw=1)
    unit = label(entry_units(emulator.control)[entries[0]])
    axes.set(xlabel="time [s]", ylabel=f"control [{unit}]")
    if len(entries) < len(among):
        title = f"the {len(entries)} of {len(among)} that change most"
        axes.set_title(title, fontsize=9, loc="left")


def _strayed_rows(synthesis: Synthesis) -> TableRows:
    """Return the readings of the state with the emulator's largest errors, the worst first; none without physics."""
    outcome = synthesis.outcome
    if not outcome.is_on_physics:
        return []
    system = replayable_system(synthesis.emulator)
    emulated = {one.name: one for one in state_readings(system, outcome.emulator_states)}
    rows: TableRows = []
    for true in state_readings(system, outcome.physics_states):
        span = float(np.ptp(np.unwrap(true.values) if true.unit == "rad" else true.values))
        # Contacts are read only where there are any.
        if true.name not in emulated or not span:
            continue
        apart = emulated[true.name].values - true.values
        if true.unit == "rad":
            apart = wrapped(apart)
        error = float(np.sqrt(np.mean(apart**2)))
        rows.append(
            {
                "number": true.name,
                "unit": true.unit,
                "error": error,
                "at the end": float(abs(apart[-1])),
                "over its range": error / span,
            }
        )
    return heapq.nlargest(MAX_CURVES, rows, key=itemgetter("over its range"))
