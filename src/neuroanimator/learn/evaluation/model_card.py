"""A model card in Markdown: what an emulator is, what taught it, how far to trust it, and how to use it.

    neuroanimator evaluate my_robot.emulator.safetensors --card README.md

Its head is the YAML that model hubs read (Mitchell et al., Model Cards for Model Reporting, 2019).
"""

from __future__ import annotations

from pathlib import Path

from neuroanimator.emulator.artifact import read_metadata
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.files.atomic import write_whole
from neuroanimator.files.zoo import licence_of
from neuroanimator.learn.evaluation.evaluate import Evaluation
from neuroanimator.learn.evaluation.machine import describe_machine
from neuroanimator.learn.evaluation.page import render_markdown

MAX_PARTS = 40
"""Maximum number of parts of a state or control named in a table; the others are counted."""

RECORDED = ("seed", "optimizer", "updates", "batch", "learning_rate")
"""Settings of a training that are named, if the file has them."""


def write_card(emulator: Emulator, file: Path, evaluation: Evaluation, path: str | Path) -> None:
    """Write the card of `emulator`, which was read from `file`, to `path`: its own description, and what was measured."""
    metadata = read_metadata(file)
    made = metadata.get("provenance") or {}
    training = made.get("training") or {}
    text = render_markdown(
        "card.md",
        emulator=emulator,
        evaluation=evaluation,
        file=file.name,
        licence=licence_of(file),
        sha256=metadata["sha256"],
        data=made.get("dataset") or {},
        training=[
            f"{name.replace('_', ' ')} {training[name]}" for name in RECORDED if name in training
        ],
        machine=describe_machine(),
        most_parts=MAX_PARTS,
    )
    write_whole(Path(path), text.encode())
