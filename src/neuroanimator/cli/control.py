"""`control`: find a controller and prove it on the physics."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = "neuroanimator control pendulum --goal upright --seconds 1.5 --out swing-up.csv"


def run(
    emulator: Annotated[str, typer.Argument(help="Emulator file, or name of a shipped one.")],
    out: Annotated[Path, typer.Option(help="CSV file for the controls.")],
    goal: Annotated[str, typer.Option(help="What to achieve; 'list' names the goals of each system.")] = "upright",
    seconds: Annotated[
        float | None, typer.Option(help="Length of the motion [s]; the goal's own if not given.")
    ] = None,
    method: Annotated[str, typer.Option(help="gauss-newton, lbfgs, or momentum as in 1998.")] = "gauss-newton",
    iterations: Annotated[int, typer.Option(help="Backward sweeps allowed.")] = 20,
    effort_weight: Annotated[float, typer.Option(help="Weight of effort in J.")] = 1.0,
    system: Annotated[
        Path | None, typer.Option(help="Your TOML file, whose step function may then run; see 'new'.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Dataset folder to refine with; simulated anew if not given.")
    ] = None,
) -> None:
    """Find a controller by gradient descent through the emulator, then replay it on MuJoCo."""
    import numpy as np

    from neuroanimator.control.report import outcome_rows
    from neuroanimator.control.synthesise import synthesise_goal
    from neuroanimator.data.transitions import read_transitions
    from neuroanimator.emulator.emulator import Emulator
    from neuroanimator.export.table import write_table
    from neuroanimator.shipped import find_emulator
    from neuroanimator.systems.own import resolve
    from neuroanimator.terminal import print_rows

    if system:
        resolve(str(system))
    found = synthesise_goal(
        Emulator.load(find_emulator(emulator)),
        goal,
        seconds,
        effort_weight=effort_weight,
        method=method,
        iterations=iterations,
        data=read_transitions(data) if data else None,
        on_refine=lambda gap: print(f"gap {gap:.2f}: learning the physics around the motion ...", file=sys.stderr),
    )
    controls = found.descent.controls
    write_table(out, np.arange(len(controls)) * found.emulator.dt, controls, found.emulator.identity.control)
    print_rows([*outcome_rows(found), ("file", out)])
