"""A model card: what an emulator is, what it was taught by, how far to believe it, and how to use it, in Markdown.

    neuroanimator evaluate my_robot.emulator.safetensors --card README.md

Its head is the YAML that model hubs read (Mitchell et al., Model Cards for Model Reporting, 2019).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from neuroanimator.emulator.artifact import read_metadata
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.evaluate import Evaluation
from neuroanimator.machine import describe_machine
from neuroanimator.state.layout import Layout
from neuroanimator.storage.files import write_whole
from neuroanimator.text import printable, short_number
from neuroanimator.zoo import licence_of

MAX_PARTS = 40
"""Maximum number of parts of a state or control named in a table; the others are counted."""

RECORDED = ("seed", "optimizer", "updates", "batch", "learning_rate")
"""What is told of a training, if the file says it."""


def write_card(emulator: Emulator, file: Path, evaluation: Evaluation, path: str | Path) -> None:
    """Write the card of `emulator`, which was read from `file`, to `path`: what it says of itself, and what was measured."""
    metadata = read_metadata(file)
    text = "\n".join(
        [
            *_head(emulator, file),
            *_what_it_is(emulator, metadata),
            *_how_it_was_made(metadata),
            *_how_far_to_believe_it(evaluation),
            *_numbers("State", emulator.state),
            *_numbers("Control", emulator.control),
            *_use(file),
        ]
    )
    write_whole(Path(path), text.encode())


def _head(emulator: Emulator, file: Path) -> list[str]:
    lines = [
        "---",
        "library_name: neuroanimator",
        "tags:",
        "- physics",
        "- emulator",
        "- animation",
    ]
    lines.append(f"- {json.dumps(printable(emulator.system))}")
    licence = licence_of(file)
    if licence:
        lines.append(f"license: {licence.lower()}")
    return [*lines, "---", ""]


def _what_it_is(emulator: Emulator, metadata: dict[str, Any]) -> list[str]:
    dt = 1e3 * emulator.dt
    return [
        f"# {_cell(emulator.system)}, n = {emulator.substeps}",
        "",
        f"An emulator of {_cell(emulator.system)}: it leaps {emulator.substeps} physics steps, {dt:g} ms, at a time, "
        f"from {emulator.state.size} numbers of state and {emulator.control.size} of control. It is differentiable, "
        "so that controllers are found by gradient descent through it.",
        "",
        f"sha256 of its content: `{metadata['sha256']}`",
        "",
    ]


def _how_it_was_made(metadata: dict[str, Any]) -> list[str]:
    made = metadata.get("provenance") or {}
    data = made.get("dataset") or {}
    training = made.get("training") or {}
    lines = ["## How it was made", ""]
    if "count" in data:
        lines.append(
            f"Taught by {data['count']:,} transitions of its physics, seed {data.get('seed')}."
        )
    told = [f"{name.replace('_', ' ')} {training[name]}" for name in RECORDED if name in training]
    if told:
        lines.append(f"Trained with {', '.join(told)}.")
    if not data and not told:
        lines.append("The file does not say.")
    return [*lines, ""]


def _how_far_to_believe_it(evaluation: Evaluation) -> list[str]:
    lines = [
        "## How far to believe it",
        "",
        f"**{_cell(str(evaluation.verdict))}.** {_cell(evaluation.note)}".rstrip(),
        "",
        "| measured | |",
        "| --- | --- |",
    ]
    for name, value in evaluation.row().items():
        shown = short_number(value) if isinstance(value, float) else str(value)
        lines.append(f"| {name.replace('_', ' ')} | {_cell(shown)} |")
    lines += ["", f"On {_cell(describe_machine())}, on runs it never saw. Weak where:", ""]
    spots = [f"- {_cell(str(spot))}" for spot in evaluation.weak_spots]
    lines += spots or ["- nothing stood out"]
    return [*lines, ""]


def _numbers(title: str, layout: Layout) -> list[str]:
    lines = [f"## {title}", "", "| part | numbers | unit |", "| --- | ---: | --- |"]
    parts = layout.to_json()
    for name, size, unit in parts[:MAX_PARTS]:
        lines.append(f"| {_cell(name)} | {size} | {_cell(unit)} |")
    if len(parts) > MAX_PARTS:
        lines.append(f"| and {len(parts) - MAX_PARTS} more | | |")
    return [*lines, ""]


def _use(file: Path) -> list[str]:
    name = json.dumps(printable(file.name))
    return [
        "## Use it",
        "",
        "```python",
        "import neuroanimator as na",
        "",
        f"emulator = na.load_emulator({name})",
        "state = emulator.step(emulator.rest, emulator.bounds.middle)",
        "```",
        "",
        "SI units, radians, Z up, quaternions wxyz. The file holds numbers and JSON; nothing in it is run.",
        "",
    ]


def _cell(value: object) -> str:
    """Return a stranger's text as it may stand in Markdown: no markup, no table, no line of its own."""
    plain = printable(str(value))
    return "".join(f"\\{letter}" if letter in "\\`*[]<>|#!" else letter for letter in plain)
