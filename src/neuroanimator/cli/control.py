"""`control`: find a controller and prove it on the physics."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from neuroanimator.errors import ArgumentError

if TYPE_CHECKING:
    import numpy as np

    from neuroanimator.control.synthesis.synthesise import Synthesis
    from neuroanimator.emulator.emulator import Emulator
    from neuroanimator.systems.system import System

EXAMPLE = "neuroanimator control pendulum --goal upright --seconds 1.5 --out swing-up.csv"
MAX_PARTS_TOLD = 6
"""Of a start, by name: more than these are a swimmer's mass points."""
MIN_PHASE_TOLD = 0.1
"""[s]"""
# Written out, as is the default of iterations: looking them up would load JAX before it is needed; a test compares.
START_HELP = (
    "Part of the state a goal is reached from, such as root.position=3,-2,8; may be given several times. "
    "The goal's own start if not given."
)
METHOD_HELP = "One of adam, gauss-newton, lbfgs, or momentum as in 1998."


def run(
    emulator: Annotated[str, typer.Argument(help="Emulator file, or name of a shipped one.")],
    out: Annotated[Path, typer.Option(help="CSV file for the controls.")],
    goal: Annotated[
        str | None,
        typer.Option(
            help="What to achieve; a system's only goal if not given. 'list' names the goals."
        ),
    ] = None,
    objective: Annotated[
        Path | None, typer.Option(help="TOML file of wishes, instead of a goal.")
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(help="Length of a motion to a goal [s]; the goal's own if not given."),
    ] = None,
    start: Annotated[list[str] | None, typer.Option(help=START_HELP)] = None,
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
            help="First guesses descended from, side by side; 1, or the file's, if not given."
        ),
    ] = None,
    effort_weight: Annotated[
        float | None, typer.Option(help="Weight of effort in a goal's J; 1 if not given.")
    ] = None,
    system: Annotated[
        Path | None,
        typer.Option(
            help="Your TOML file: its goals may be new, and its step function may then run; see 'new'."
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(help="Dataset folder to refine with; simulated anew if not given."),
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="JSON Lines file for J of every iteration.")
    ] = None,
    glb: Annotated[
        Path | None,
        typer.Option(help="GLB file for the motion on the physics, the emulator's as a ghost."),
    ] = None,
) -> None:
    """Find a controller by gradient descent through the emulator, then replay it on the true physics."""
    from neuroanimator.terminal import phase, print_rows
    from neuroanimator.text import print_line

    began = time.perf_counter()
    with phase("loading"):
        from neuroanimator.control.synthesis.progress import watching
        from neuroanimator.control.synthesis.summary import outcome_rows, warnings_of
        from neuroanimator.data.store import read_transitions
        from neuroanimator.export.formats import emulator_for
        from neuroanimator.systems import load_system

        own = load_system(str(system)) if system else None
        model = emulator_for([glb] if glb else [], emulator)
        search = _search(model, own, goal, objective, seconds, effort_weight, start or [])
    if isinstance(search, str):
        return print_line(search)
    with watching(log, iterations) as on_iteration:
        found = search.find(
            method=method,
            iterations=iterations,
            data=read_transitions(data) if data else None,
            measures_trust=True,
            on_iteration=on_iteration,
            on_refine=_say_gap,
            **({} if starts is None else {"starts": starts}),
        )
    for warning in warnings_of(found):
        print_line(f"neuroanimator: {warning}", to_stderr=True)
    _write(found, out, glb)
    files = [("file", path) for path in (out, glb, log) if path]
    return print_rows([("start", search.start), *outcome_rows(found), *_time_rows(began), *files])


def _say_gap(gap: float) -> None:
    print(f"gap {gap:.2f}: learning the physics around the motion ...", file=sys.stderr)


class _Search(NamedTuple):
    """What finds the controller, and where the motion starts, in words."""

    find: Callable[..., Synthesis]
    start: str


def _search(
    emulator: Emulator,
    own: System | None,
    goal: str | None,
    objective: Path | None,
    seconds: float | None,
    effort_weight: float | None,
    starts: list[str],
) -> _Search | str:
    """Return what finds the controller, for an objective file or a goal; or what to say if nothing is to find.

    `own` is the emulator's system, perhaps with goals written after training.
    """
    from neuroanimator.control.objective.goals import usual_goal
    from neuroanimator.control.synthesis.objective_file import read_objective, synthesise_wanted
    from neuroanimator.control.synthesis.synthesise import check_same_system
    from neuroanimator.evaluation.held_out import system_of

    system = own or system_of(emulator)
    check_same_system(emulator, system)
    if objective is None:
        return _search_goal(
            emulator, system, goal or usual_goal(system), seconds, effort_weight, starts
        )
    if (goal, seconds, effort_weight, starts) != (None, None, None, []):
        raise ArgumentError(
            "objective: its file says all that --goal, --seconds, --start and --effort-weight do. Leave these out."
        )
    wanted = read_objective(objective, system)
    return _Search(
        partial(synthesise_wanted, emulator, wanted), start_in_words(system, wanted.start)
    )


def _search_goal(
    emulator: Emulator,
    system: System,
    goal: str,
    seconds: float | None,
    effort_weight: float | None,
    starts: list[str],
) -> _Search | str:
    from neuroanimator.control.objective.goals import find_goal, goal_start
    from neuroanimator.control.synthesis.synthesise import synthesise_goal
    from neuroanimator.state.start import read_starts

    verdict = find_goal(system, goal)[1]
    start = system.start_at(read_starts(starts)) if starts else goal_start(system, goal)
    words = start_in_words(system, start)
    if verdict(start):
        return (
            f"Already there: {system.name} at its start ({words}) fulfils the goal '{goal}'. Nothing to find, nothing "
            "written. Name another start, such as --start root.position=3,-2,8."
        )
    weight = 1.0 if effort_weight is None else effort_weight
    find = partial(
        synthesise_goal,
        emulator,
        goal,
        seconds,
        start=start,
        effort_weight=weight,
        goals_from=system,
    )
    return _Search(find, words)


def start_in_words(system: System, start: np.ndarray) -> str:
    """Return which parts of `start` (S,) differ from rest, with their numbers and units."""
    told = []
    for part in system.state.slices:
        numbers = start[system.state.index(part.name)]
        if (numbers != system.rest[system.state.index(part.name)]).any():
            told.append(
                f"{part.name} {', '.join(f'{number:.4g}' for number in numbers)} {part.unit}"
            )
    if len(told) > MAX_PARTS_TOLD:
        return f"{len(told)} parts of the state other than at rest"
    return "; ".join(told) or "at rest"


def _time_rows(began: float) -> list[tuple[str, object]]:
    """Return how long everything since `began` took, and the longest of its phases."""
    from neuroanimator.terminal import phase_seconds

    phases = sorted(phase_seconds().items(), key=lambda item: -item[1])
    told = ", ".join(
        f"{name} {seconds:.1f}" for name, seconds in phases if seconds >= MIN_PHASE_TOLD
    )
    total = f"{time.perf_counter() - began:.1f} s"
    return [("time in all", f"{total}: {told}" if told else total)]


def _write(found: Synthesis, out: Path, glb: Path | None) -> None:
    import numpy as np

    from neuroanimator.export.comparison import write_comparison
    from neuroanimator.export.csv_file import write_table
    from neuroanimator.terminal import phase

    controls, emulator = found.descent.controls, found.emulator
    write_table(out, np.arange(len(controls)) * emulator.dt, controls, emulator.control)
    if glb:
        with phase("drawing"):
            write_comparison(emulator, found.outcome, glb)
