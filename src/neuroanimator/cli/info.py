"""`info`: what a file says about itself."""

from __future__ import annotations

from typing import Annotated

import typer

EXAMPLE = "neuroanimator info pendulum-50"


def run(
    emulator: Annotated[str, typer.Argument(help="Emulator file, or name of a shipped one.")],
    json: Annotated[bool, typer.Option("--json", help="Print all of it as JSON.")] = False,
) -> None:
    """Check an emulator file and show what it is."""
    from json import dumps

    from neuroanimator.emulator.artifact import load, read_metadata, tensors_of
    from neuroanimator.shipped import find_emulator
    from neuroanimator.terminal import print_rows

    path = find_emulator(emulator)
    metadata, model = read_metadata(path), load(path)
    if json:
        print(dumps(metadata, indent=2, sort_keys=True))
        return
    network = metadata["network"]
    print_rows(
        [
            ("file", path.name),
            ("system", metadata["system"]),
            ("super step", f"{metadata['dt'] * 1e3:g} ms ({metadata['substeps']} physics steps)"),
            ("state", ", ".join(model.identity.state.names)),
            ("control", ", ".join(model.identity.control.names)),
            (
                "control bounds",
                ", ".join(f"{low:g} to {high:g}" for low, high in zip(*metadata["bounds"], strict=True)),
            ),
            ("network", f"{network['kind']} {'x'.join(map(str, network['widths']))}"),
            ("numbers stored", f"{sum(array.size for array in tensors_of(model).values()):,}"),
            ("sha256", metadata["sha256"]),
        ]
    )
