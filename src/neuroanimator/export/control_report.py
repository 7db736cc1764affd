"""The report of a controller: what it does on the physics, how J came down, and its controls, as one page."""

from __future__ import annotations

import html
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from neuroanimator.control.synthesis.replay import Replay
from neuroanimator.control.synthesis.summary import outcome_rows
from neuroanimator.control.synthesis.synthesise import Synthesis
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.held_out import replayable_system
from neuroanimator.evaluation.page import (
    facts_html,
    glossary_html,
    made_html,
    table_html,
    write_page,
)
from neuroanimator.evaluation.plots import EMULATOR, PHYSICS, QUIET, plot
from neuroanimator.evaluation.weakness.readings import entry_names, entry_units, state_readings
from neuroanimator.export.film.inline import replay_html
from neuroanimator.systems.system import System
from neuroanimator.text import printable, short_number

MAX_CURVES = 6
"""Maximum number of controls of a unit drawn, those that change most, and of entries told in which the emulator strayed."""

COURSE_CAPTION = (
    "J on the emulator after every iteration: one sweep forward and one back through all super steps. Where a new descent "
    "begins the curve is broken: it begins at other controls, or follows an emulator that a replay has corrected. The dashed "
    "line is J on the physics at the end."
)

CONTROLS_CAPTION = (
    "Each is held for a super step. Dotted lines are the bounds of what motors can do."
)

STRAYED_CAPTION = (
    "How far the emulator's motion lies from the physics' under the same controls, number by number: the root mean square "
    "over the motion, at its end, and over how far the number ranges on the physics."
)

MEANINGS = {
    "J": "What the descent makes small: how far the motion is from what was asked for, and the effort.",
    "iteration": "One sweep forward and one back through the emulator, which gives the slope of J in every control.",
    "corrections by replay": "Controls are replayed on the physics; what the emulator gets wrong there is added to it, "
    "and a short descent follows.",
    "refinements by training": "Where the gap stays large, a copy of the emulator learns the physics around the motion.",
    "physics steps taken": "What the true physics was asked for, over all replays and refinements.",
    "gradient against the physics'": "Cosine between the slopes of J through the emulator and through the physics: "
    "1 is the same direction.",
    "gap": "J on the physics, less J on the emulator. Below zero the physics does better than was foretold.",
}
"""What the words of the report mean."""


class _Strayed(NamedTuple):
    """How far what is read off the state lies from the physics' along a motion."""

    name: str
    unit: str
    error: float
    """Root mean square, in `unit`."""
    last: float
    """Magnitude at the end, in `unit`."""
    relative: float
    """`error` over how far the number ranges."""


def write_control_report(
    synthesis: Synthesis, path: str | Path, *, asked: Sequence[tuple[str, object]] = ()
) -> None:
    """Write the report of `synthesis` as one page that needs no other file; `asked` adds rows to the head of its table.

    Where nothing can be drawn, the page says so in the place of the film.
    """
    emulator = synthesis.emulator
    rows = [*asked, *outcome_rows(synthesis)]
    parts = [
        f"<h1>NeuroAnimator: a controller of the {html.escape(emulator.system)}</h1>",
        made_html(),
        facts_html(rows),
        glossary_html("What the words mean", MEANINGS),
        "<h2>The motion</h2>",
        replay_html(emulator, synthesis.outcome),
        search_html(synthesis),
    ]
    write_page(path, "NeuroAnimator: a controller", parts)


def search_html(synthesis: Synthesis) -> str:
    """Return how the controls of `synthesis` were found, what they are, and how true the emulator was along the motion."""
    parts = [
        "<h3>J over the iterations</h3>",
        plot(partial(_draw_courses, synthesis=synthesis)),
        f"<p>{COURSE_CAPTION}</p>",
        "<h3>Controls over time</h3>",
        *_control_plots(synthesis),
        f"<p>{CONTROLS_CAPTION}</p>",
    ]
    if synthesis.outcome.is_on_physics:
        parts.append("<h3>Where the emulator strayed</h3>")
        parts.append(_strayed_table(synthesis.emulator, synthesis.outcome))
        parts.append(f"<p>{STRAYED_CAPTION}</p>")
    return "".join(parts)


def _draw_courses(axes: Axes, synthesis: Synthesis) -> None:
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
    axes.legend(frameon=False)


def _control_plots(synthesis: Synthesis) -> list[str]:
    """Return a plot of the controls for each unit."""
    emulator = synthesis.emulator
    units = entry_units(emulator.control)
    plots = []
    for unit in dict.fromkeys(units):
        entries = [entry for entry, other in enumerate(units) if other == unit]
        chosen = _liveliest(synthesis.controls, entries)
        plots.append(
            plot(partial(_draw_controls, synthesis=synthesis, entries=chosen, among=len(entries)))
        )
    return plots


def _liveliest(rows: Float[np.ndarray, "T C"], entries: Sequence[int]) -> list[int]:
    """Return those of `entries` that range farthest in `rows`, in their own order."""
    ranges = np.ptp(rows[:, entries], axis=0)
    first = np.argsort(-ranges, kind="stable")[:MAX_CURVES]
    return [entries[number] for number in sorted(first)]


def _draw_controls(axes: Axes, synthesis: Synthesis, entries: Sequence[int], among: int) -> None:
    """Draw some controls of one unit, of `among` that there are."""
    emulator = synthesis.emulator
    names = entry_names(emulator.control)
    controls = synthesis.controls
    # Held until the end of the last super step.
    times = np.arange(len(controls) + 1) * emulator.dt
    for entry in entries:
        held = np.append(controls[:, entry], controls[-1:, entry])
        axes.step(times, held, where="post", lw=1.2, label=_shown(names[entry]))
    for limit in _bounds_of(emulator, entries):
        axes.axhline(limit, color=QUIET, ls=":", lw=1)
    unit = _shown(entry_units(emulator.control)[entries[0]])
    axes.set(xlabel="time [s]", ylabel=f"control [{unit}]")
    if len(entries) < among:
        axes.set_title(f"the {len(entries)} of {among} that change most", fontsize=9, loc="left")
    axes.legend(frameon=False, fontsize=8)


def _bounds_of(emulator: Emulator, entries: Sequence[int]) -> list[float]:
    """Return the bounds of some controls, each number once."""
    low = np.asarray(emulator.bounds.low)[list(entries)]
    high = np.asarray(emulator.bounds.high)[list(entries)]
    return [float(limit) for limit in np.unique([*low, *high])]


def _strayed_table(emulator: Emulator, outcome: Replay) -> str:
    """Return a table of what the emulator strayed in farthest."""
    rows = []
    for strayed in _strayed(replayable_system(emulator), outcome)[:MAX_CURVES]:
        rows.append(
            {
                "number": strayed.name,
                "unit": strayed.unit,
                "error": short_number(strayed.error),
                "at the end": short_number(strayed.last),
                "over its range": short_number(strayed.relative),
            }
        )
    return table_html(rows) if rows else ""


def _strayed(system: System, outcome: Replay) -> list[_Strayed]:
    """Return how far each reading of the state that changes strayed, the worst first."""
    emulated = state_readings(system, outcome.emulator_states)
    true = state_readings(system, outcome.physics_states)
    found = []
    for one, other in zip(
        emulated, true, strict=False
    ):  # contacts are read last, and where there are any
        values = other.values
        apart = one.values - values
        if other.unit == "rad":
            values = np.unwrap(values)
            apart = (apart + np.pi) % (2 * np.pi) - np.pi
        span = float(np.ptp(values))
        if one.name == other.name and span > 0:
            error = float(np.sqrt((apart**2).mean()))
            last = float(abs(apart[-1]))
            found.append(_Strayed(other.name, other.unit, error, last, error / span))
    return sorted(found, key=lambda strayed: -strayed.relative)


def _shown(text: str) -> str:
    """Return a name as Matplotlib shows it: what is between dollars it reads as formulas."""
    return printable(text).replace("$", r"\$")
