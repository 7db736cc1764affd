"""A small cloth and an emulator of it that learnt nothing: for laws that hold of any weights."""

from __future__ import annotations

from pathlib import Path

from neuroanimator import DatasetConfig, Emulator, TrainingConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.physics.loading import resolve
from neuroanimator.scaffold.write_toml import write_definition

SIDE = 8
"""Nodes along a side."""


def square_obj() -> str:
    """Return a square of 1 m that hangs along -Z, as an OBJ file."""
    lines = []
    for row in range(SIDE):
        for column in range(SIDE):
            lines.append(f"v {column / (SIDE - 1) - 0.5} 0 {1.5 - row / (SIDE - 1)}")
    for row in range(SIDE - 1):
        for column in range(SIDE - 1):
            first = row * SIDE + column + 1
            lines.append(f"f {first} {first + SIDE} {first + SIDE + 1} {first + 1}")
    return "\n".join(lines) + "\n"


def untrained_cloth(folder: Path) -> Emulator:
    """Return the emulator of a cloth, whose holder turns, too; its definition is written into `folder`."""
    (folder / "cloth.obj").write_text(square_obj())
    toml, _ = write_definition(str(folder / "cloth.obj"))
    written = toml.read_text().replace("shapes = 96", "shapes = 10")
    toml.write_text(written.replace("[movers.holder]", "[movers.holder]\nturns = true"))
    name, text, substeps = resolve(str(toml))
    config = DatasetConfig(
        system=name, definition=text, substeps=substeps, count=72, samples_per_run=36
    )
    return build_emulator(simulate_transitions(config), TrainingConfig(widths=(8,)))
