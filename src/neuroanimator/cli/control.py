"""`control`: find a controller and prove it on the physics."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from neuroanimator.errors import ArgumentError

if TYPE_CHECKING:
    from neuroanimator.control.synthesise import Synthesis
    from neuroanimator.emulator.emulator import Emulator
    from neuroanimator.systems.system import System

EXAMPLE = "neuroanimator control pendulum --goal upright --seconds 1.5 --out swing-up.csv"
# Written out, as is the default of iterations: looking them up would load JAX before it is needed; a test compares.
METHOD_HELP = "One of adam, gauss-newton, lbfgs, or momentum as in 1998."


def run(
    emulator: Annotated[str, typer.Argument(help="Emulator file, or name of a shipped one.")],
    out: Annotated[Path, typer.Option(help="CSV file for the controls.")],
    goal: Annotated[
        str | None, typer.Option(help="What to achieve; a system's only goal if not given. 'list' names the goals.")
    ] = None,
    objective: Annotated[Path | None, typer.Option(help="TOML file of wishes, instead of a goal.")] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Length of a motion to a goal [s]; the goal's own if not given.")
    ] = None,
    method: Annotated[str, typer.Option(help=METHOD_HELP)] = "gauss-newton",
    iterations: Annotated[
        int, typer.Option(help="Backward sweeps of a descent; up to five corrections take two more each.")
    ] = 18,
    starts: Annotated[
        int | None, typer.Option(help="First guesses descended from, side by side; 1, or the file's, if not given.")
    ] = None,
    effort_weight: Annotated[float | None, typer.Option(help="Weight of effort in a goal's J; 1 if not given.")] = None,
    system: Annotated[
        Path | None,
        typer.Option(help="Your TOML file: its goals may be new, and its step function may then run; see 'new'."),
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Dataset folder to refine with; simulated anew if not given.")
    ] = None,
    log: Annotated[Path | None, typer.Option(help="JSON Lines file for J of every iteration.")] = None,
    glb: Annotated[
        Path | None, typer.Option(help="GLB file for the motion on the physics, the emulator's as a ghost.")
    ] = None,
) -> None:
    """Find a controller by gradient descent through the emulator, then replay it on the true physics."""
    from neuroanimator.control.report import outcome_rows, warnings_of
    from neuroanimator.control.watch import watching
    from neuroanimator.data.transitions import read_transitions
    from neuroanimator.export.by_suffix import emulator_for
    from neuroanimator.systems import load_system
    from neuroanimator.terminal import print_rows
    from neuroanimator.text import print_line

    own = load_system(str(system)) if system else None
    model = emulator_for([glb] if glb else [], emulator)
    search = _search(model, own, goal, objective, seconds, effort_weight)
    with watching(log, iterations) as on_iteration:
        found = search(
            method=method,
            iterations=iterations,
            data=read_transitions(data) if data else None,
            measures_trust=True,
            on_iteration=on_iteration,
            on_refine=lambda gap: print(f"gap {gap:.2f}: learning the physics around the motion ...", file=sys.stderr),
            **({} if starts is None else {"starts": starts}),
        )
    for warning in warnings_of(found):
        print_line(f"neuroanimator: {warning}", to_stderr=True)
    _write(found, out, glb)
    print_rows([*outcome_rows(found), *(("file", path) for path in (out, glb, log) if path)])


def _search(
    emulator: Emulator,
    own: System | None,
    goal: str | None,
    objective: Path | None,
    seconds: float | None,
    effort_weight: float | None,
) -> Callable[..., Synthesis]:
    """Return what finds the controller: for an objective file, or for a goal; `own` may have goals of its own."""
    from neuroanimator.control.goals import usual_goal
    from neuroanimator.control.objective_file import read_objective, synthesise_wanted
    from neuroanimator.control.synthesise import check_same_system, synthesise_goal
    from neuroanimator.evaluation.accuracy import system_of

    system = own or system_of(emulator)
    check_same_system(emulator, system)
    if objective is None:
        weight = 1.0 if effort_weight is None else effort_weight
        name = goal or usual_goal(system)
        return partial(synthesise_goal, emulator, name, seconds, effort_weight=weight, goals_from=system)
    if (goal, seconds, effort_weight) != (None, None, None):
        raise ArgumentError(
            "objective: its file says all that --goal, --seconds and --effort-weight do. Leave these out."
        )
    return partial(synthesise_wanted, emulator, read_objective(objective, system))


def _write(found: Synthesis, out: Path, glb: Path | None) -> None:
    import numpy as np

    from neuroanimator.export.proof import write_proof
    from neuroanimator.export.table import write_table

    controls, emulator = found.descent.controls, found.emulator
    write_table(out, np.arange(len(controls)) * emulator.dt, controls, emulator.identity.control)
    if glb:
        write_proof(emulator, found.outcome, glb)
