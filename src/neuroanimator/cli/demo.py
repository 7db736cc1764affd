"""The verb `demo`: the main job, from physics to a controlled pendulum."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from neuroanimator.cli.main_job import run_demo

EXAMPLE = "neuroanimator demo --out out"


def run(
    out: Annotated[Path, typer.Option(help="Folder for everything the demo makes.")] = Path("out"),
) -> None:
    """Learn a three-link pendulum, measure the emulator, swing it up, verify it on MuJoCo, draw it. About a minute."""
    run_demo(out)
