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

EXAMPLE = "neuroanimator control pendulum --goal upright --seconds 1.5 --out swing-up.csv"
DEFAULT_GOAL = "upright"
# Written out, as is the default of iterations: looking them up would load JAX before it is needed; a test compares.
METHOD_HELP = "One of adam, gauss-newton, lbfgs, or momentum as in 1998."


def run(
    emulator: Annotated[str, typer.Argument(help="Emulator file, or name of a shipped one.")],
    out: Annotated[Path, typer.Option(help="CSV file for the controls.")],
    goal: Annotated[
        str | None, typer.Option(help="What to achieve, 'upright' if not given; 'list' names each system's goals.")
    ] = None,
    objective: Annotated[Path | None, typer.Option(help="TOML file of wishes, instead of a goal.")] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Length of a motion to a goal [s]; the goal's own if not given.")
    ] = None,
    method: Annotated[str, typer.Option(help=METHOD_HELP)] = "gauss-newton",
    iterations: Annotated[int, typer.Option(help="Backward sweeps allowed.")] = 18,
    starts: Annotated[
        int | None, typer.Option(help="First guesses descended from, side by side; 1, or the file's, if not given.")
    ] = None,
    effort_weight: Annotated[float | None, typer.Option(help="Weight of effort in a goal's J; 1 if not given.")] = None,
    system: Annotated[
        Path | None, typer.Option(help="Your TOML file, whose step function may then run; see 'new'.")
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
    from neuroanimator.systems.own import trust_files
    from neuroanimator.terminal import print_rows
    from neuroanimator.text import print_line

    if system:
        trust_files(system)
    model = emulator_for([glb] if glb else [], emulator)
    search = _search(model, goal, objective, seconds, effort_weight)
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
    emulator: Emulator, goal: str | None, objective: Path | None, seconds: float | None, effort_weight: float | None
) -> Callable[..., Synthesis]:
    """Return what finds the controller: for an objective file, or for a goal."""
    from neuroanimator.control.objective_file import read_objective, synthesise_wanted
    from neuroanimator.control.synthesise import synthesise_goal
    from neuroanimator.evaluation.accuracy import system_of

    if objective is None:
        weight = 1.0 if effort_weight is None else effort_weight
        return partial(synthesise_goal, emulator, goal or DEFAULT_GOAL, seconds, effort_weight=weight)
    if (goal, seconds, effort_weight) != (None, None, None):
        raise ArgumentError(
            "objective: its file says all that --goal, --seconds and --effort-weight do. Leave these out."
        )
    return partial(synthesise_wanted, emulator, read_objective(objective, system_of(emulator)))


def _write(found: Synthesis, out: Path, glb: Path | None) -> None:
    import numpy as np

    from neuroanimator.export.proof import write_proof
    from neuroanimator.export.table import write_table

    controls, emulator = found.descent.controls, found.emulator
    write_table(out, np.arange(len(controls)) * emulator.dt, controls, emulator.identity.control)
    if glb:
        write_proof(emulator, found.outcome, glb)
