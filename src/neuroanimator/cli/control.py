"""`control`: find a controller and prove it on the physics."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from neuroanimator.cli.closed_loop import run_closed_loop
from neuroanimator.cli.control_output import start_in_words, time_rows
from neuroanimator.cli.formats import emulator_for
from neuroanimator.cli.shared_options import START_HELP, OneEmulator
from neuroanimator.cli.usage import refuse_given
from neuroanimator.control.descent.options import DescentOptions
from neuroanimator.control.objective.goals import find_goal, goal_start, is_reached, usual_goal
from neuroanimator.control.synthesis.attempt import SearchOptions
from neuroanimator.control.synthesis.objective_file import read_objective, synthesise_file
from neuroanimator.control.synthesis.progress import watching
from neuroanimator.control.synthesis.summary import outcome_rows, warnings_of
from neuroanimator.control.synthesis.synthesise import Synthesis, check_same_system, synthesise_goal
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.comparison import write_comparison
from neuroanimator.export.csv_file import write_controls
from neuroanimator.learn.data.store import read_transitions
from neuroanimator.learn.evaluation.held_out import replayable_system
from neuroanimator.learn.refinement import REFINING_MINUTES, Refinement
from neuroanimator.physics import load_system
from neuroanimator.state.start import read_starts
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase, print_rows
from neuroanimator.text import print_line

EXAMPLE = "neuroanimator control pendulum --goal upright --seconds 1.5 --out swing-up.csv"
CLOSED_LOOP_HELP = (
    "Replan at every super step, from the actual state of the physics, to hold the goal. "
    "If that alone misses it, a motion to it is searched for first."
)
THRESHOLD_HELP = "Keep the motion where the emulator's trust score is at most this; 1 is the edge of training. Takes longer."
MINUTES_HELP = (
    "Maximum time for training around the motion, where emulator and physics disagree [minutes]; "
    "0.5 if not given, 0 for none."
)
METHOD_HELP = "One of adam, gauss-newton, lbfgs, or momentum as in 1998."


def run(
    emulator: OneEmulator,
    out: Annotated[Path, typer.Option(help="CSV file for the controls.")],
    goal: Annotated[
        str | None,
        typer.Option(
            help="What to achieve; a system's only goal if not given. 'list' names the goals."
        ),
    ] = None,
    objective: Annotated[
        Path | None, typer.Option(help="TOML file of costs, instead of a goal.")
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(help="Length of a motion to a goal [s]; the goal's own if not given."),
    ] = None,
    start: Annotated[
        list[str] | None, typer.Option(help=f"{START_HELP} The goal's own if not given.")
    ] = None,
    method: Annotated[str, typer.Option(help=METHOD_HELP)] = "gauss-newton",
    iterations: Annotated[
        int,
        typer.Option(
            help="Backward sweeps of a descent; up to five corrections take two more each."
        ),
    ] = 18,
    starts: Annotated[
        int | None,
        typer.Option(
            help="Number of initial guesses to descend from, side by side; 1, or the file's, if not given."
        ),
    ] = None,
    effort_weight: Annotated[
        float | None, typer.Option(help="Weight of effort in a goal's J; 1 if not given.")
    ] = None,
    threshold: Annotated[float | None, typer.Option(help=THRESHOLD_HELP)] = None,
    closed_loop: Annotated[bool, typer.Option("--closed-loop", help=CLOSED_LOOP_HELP)] = False,
    horizon: Annotated[
        float | None,
        typer.Option(
            help="How far a plan of --closed-loop looks ahead [s]; 20 super steps if not given."
        ),
    ] = None,
    system: Annotated[
        Path | None,
        typer.Option(
            help="Your TOML file: its goals may be new, and its step function may then run; see 'new'."
        ),
    ] = None,
    data: Annotated[
        str | None,
        typer.Option(help="Dataset folder or URL to refine with; simulated anew if not given."),
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="JSON Lines file for J of every iteration.")
    ] = None,
    minutes: Annotated[float | None, typer.Option(help=MINUTES_HELP)] = None,
    glb: Annotated[
        Path | None,
        typer.Option(help="GLB file for the motion on the physics, the emulator's as a ghost."),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            help="HTML file with a film, J over the iterations, and the controls over time."
        ),
    ] = None,
) -> None:
    """Find a controller by gradient descent through the emulator, then replay it on the true physics."""
    with phase("loading"):
        own = load_system(str(system)) if system else None
        model = emulator_for([glb] if glb else [], emulator)
        if closed_loop:
            others = {
                "objective": objective,
                "starts": starts,
                "data": data,
                "log": log,
                "report": report,
                "threshold": threshold,
                "minutes": minutes,
            }
            refuse_given(others, "does not go with --closed-loop. Leave one of them out.")
        elif horizon is not None:
            raise ArgumentError("horizon: applies to --closed-loop only. Leave it out.")
        if objective is None:
            search = _search_goal(model, own, goal, seconds, effort_weight, threshold, start or [])
        else:
            if (goal, seconds, effort_weight, threshold, start or []) != (None,) * 4 + ([],):
                raise ArgumentError(
                    "objective: its file sets all that --goal, --seconds, --start, --effort-weight and --threshold set. "
                    "Leave these out."
                )
            search = _search_objective(model, own, objective, starts)
    if search.closed_loop is not None and closed_loop:
        return search.closed_loop(seconds=seconds, horizon=horizon, out=out, glb=glb)
    if search.nothing_to_find:
        return print_line(search.nothing_to_find)
    if minutes is None:
        minutes = REFINING_MINUTES
    with watching(log, iterations) as on_iteration:
        descent = DescentOptions(
            method=method,
            iterations=iterations,
            starts=1 if starts is None else starts,
            on_iteration=on_iteration,
        )
        refinement = Refinement(
            minutes=minutes,
            data=read_transitions(data) if data else None,
            on_refine=partial(_say_gap, minutes),
        )
        options = SearchOptions(descent, refine=refinement, measures_trust=True)
        synthesis = search.find(options=options)
    improve = _improve_command(emulator, out, start or [], system)
    for warning in warnings_of(synthesis, improve):
        print_line(f"neuroanimator: {warning}", to_stderr=True)
    _write(synthesis, out, glb)
    if report:
        with phase("drawing"):
            from neuroanimator.film.control_report import write_control_report  # with matplotlib

            write_control_report(synthesis, report, asked=[("start", search.start)])
    files = [("file", path) for path in (out, glb, log, report) if path]
    rows = [("start", search.start), *outcome_rows(synthesis), *time_rows(), *files]
    return print_rows(rows)


def _improve_command(emulator: str, out: Path, start: list[str], system: Path | None) -> str:
    """Return the command by which the emulator learns the physics around the controls in the file `out`."""
    words = ["neuroanimator", "improve", emulator, "--controls", str(out)]
    for part in start:
        words += ["--start", part]
    if system is not None:
        words += ["--system", str(system)]
    return shlex.join([*words, "--out", "better.emulator.safetensors"])


def _say_gap(minutes: float, gap: float) -> None:

    print_line(
        f"gap {gap:.2f}: training on the physics around the motion, at most {60 * minutes:g} s in all "
        "(--minutes allows more, or none) ...",
        to_stderr=True,
    )


class _Search(NamedTuple):
    """How to find the controller."""

    find: Callable[..., Synthesis]
    start: str
    """Where the motion starts, in words."""
    nothing_to_find: str = ""
    """Message if the start already fulfils the goal; empty if it does not."""
    closed_loop: Callable[..., None] | None = None
    """Function that pursues the goal in closed loop; for goals only."""


def _search_objective(
    emulator: Emulator, own: System | None, path: Path, starts: int | None
) -> _Search:
    """Return the search for an objective file; `own` is the emulator's system, if it was given, `starts` replace the file's."""
    system = _checked_system(emulator, own)
    file = read_objective(path, system)
    if starts is not None:
        file = replace(file, starts=starts)
    find = partial(synthesise_file, emulator, file)
    return _Search(find, start_in_words(system, file.start))


def _search_goal(
    emulator: Emulator,
    own: System | None,
    name: str | None,
    seconds: float | None,
    effort_weight: float | None,
    threshold: float | None,
    starts: list[str],
) -> _Search:
    """Return the search for a goal; the goals of `own` may have been written after training."""
    system = _checked_system(emulator, own)
    name = name or usual_goal(system)
    goal = find_goal(system, name)
    if starts:
        start = system.start_at(read_starts(starts))
    else:
        start = goal_start(system, name)
    weight = 1.0 if effort_weight is None else effort_weight
    find = partial(
        synthesise_goal,
        emulator,
        system,
        name,
        seconds,
        start=start,
        effort_weight=weight,
        threshold=threshold,
    )
    closed_loop = partial(
        run_closed_loop,
        emulator,
        system,
        name,
        start,
        effort_weight=weight,
    )
    words = start_in_words(system, start)
    if not is_reached(system, goal, start):
        return _Search(find, words, closed_loop=closed_loop)
    told = (
        f"Nothing to find, so nothing was written: {system.name} already meets the goal '{name}' at its start "
        f"({words}). Choose another start, such as --start root.position=3,-2,8."
    )
    return _Search(find, words, nothing_to_find=told, closed_loop=closed_loop)


def _checked_system(emulator: Emulator, own: System | None) -> System:
    """Return `own`, or the system that the emulator names; ArgumentError if it has another state or control.

    If its model is missing, or is not the one the emulator was trained on, an error says so, and nothing is simulated.
    """
    physics = replayable_system(emulator)
    system = own or physics
    check_same_system(emulator, system)
    if physics.missing:
        system.missing = physics.missing
        print_line(f"neuroanimator: {physics.missing}", to_stderr=True)
    return system


def _write(synthesis: Synthesis, out: Path, glb: Path | None) -> None:

    emulator = synthesis.emulator
    write_controls(out, synthesis.controls, emulator)
    if glb:
        with phase("drawing"):
            write_comparison(emulator, synthesis.outcome, glb)
