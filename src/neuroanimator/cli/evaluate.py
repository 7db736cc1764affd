"""`evaluate`: accuracy and speed of emulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = "neuroanimator evaluate pendulum-25 pendulum-50 pendulum-100 --report report.html"


def run(
    emulators: Annotated[list[str], typer.Argument(help="Emulator files, or names of shipped ones.")],
    data: Annotated[Path | None, typer.Option(help="Dataset folder, to compare with cheap predictors too.")] = None,
    report: Annotated[Path | None, typer.Option(help="HTML file with plots.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print rows as JSON.")] = False,
) -> None:
    """Measure emulators on unseen runs against fine physics, and their speed against MuJoCo."""
    from json import dumps

    from neuroanimator.data.transitions import read_transitions
    from neuroanimator.emulator.emulator import Emulator
    from neuroanimator.evaluation.evaluate import evaluate
    from neuroanimator.evaluation.report import write_report
    from neuroanimator.shipped import find_emulator
    from neuroanimator.terminal import print_table, progress_bar

    loaded = [Emulator.load(find_emulator(name)) for name in emulators]
    transitions = read_transitions(data) if data else None
    found = []
    with progress_bar("emulators", len(loaded)) as bar:
        for emulator in loaded:
            found.append(evaluate(emulator, data=transitions))
            bar.advance_to(len(found))
    if report:
        write_report(found, report)
    rows = [evaluation.row() for evaluation in found]
    print(dumps(rows, indent=2)) if json else print_table([dict(row) for row in rows])
