"""Options that several verbs have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from neuroanimator.film.options import CAMERAS, DEFAULT_SIZE

OneEmulator = Annotated[str, typer.Argument(help="Emulator file, or name of a shipped one.")]
"""The argument `emulator`."""

OwnPhysics = Annotated[
    Path | None,
    typer.Option(help="Your TOML file, whose model or step function is then used; see 'new'."),
]
"""The option `--system` of verbs that simulate."""

Resample = Annotated[
    bool,
    typer.Option("--resample", help="Interpolate recordings whose samples are not evenly spaced."),
]
"""The option `--resample`."""

SIZE = "{}x{}".format(*DEFAULT_SIZE)
"""Default size of a film [pixels], as on the command line."""

Size = Annotated[str, typer.Option(help="Width x height of a film [pixels].")]
"""The option `--size`."""

Camera = Annotated[
    str,
    typer.Option(
        help="For films: "
        + "; ".join(f"{name} ({camera.about})" for name, camera in CAMERAS.items())
        + "."
    ),
]
"""The option `--camera`."""

START_HELP = "Part of the initial state, such as root.position=3,-2,8; may be given several times."
"""The help of `--start`."""
