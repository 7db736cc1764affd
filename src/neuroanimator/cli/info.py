"""The verb `info`: show what is in a file."""

from __future__ import annotations

from json import dumps
from pathlib import Path
from typing import Annotated, Any

import typer

from neuroanimator.cli.inspection_output import print_components, print_weak_spots, show_dataset
from neuroanimator.codegen.backend import backend_in_words
from neuroanimator.control.policies.abstract_policy import read_policy_file
from neuroanimator.control.policies.policy import Policy
from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.emulator.artifact import emulator_from
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.error_bounds import bounds_in_words
from neuroanimator.emulator.trust_summary import UNJUDGED
from neuroanimator.errors import ArgumentError
from neuroanimator.files.atomic import Metadata, read_tensors
from neuroanimator.files.places import is_url, place_of
from neuroanimator.files.zoo import find_emulator, find_policy
from neuroanimator.learn.data.stored import open_to_measure
from neuroanimator.learn.evaluation.weakness.inspection import inspect
from neuroanimator.physics.loading import trust_files
from neuroanimator.state.layout import Layout
from neuroanimator.terminal import Rows, phase, print_rows

EXAMPLE = "neuroanimator info pendulum-50"

MAX_PARTS = 6
"""Maximum number of parts of a state or control listed by name; the rest are counted."""


def run(
    file: Annotated[
        str,
        typer.Argument(
            help="Emulator or policy file, folder or URL made by 'generate', or name of a shipped emulator."
        ),
    ],
    json: Annotated[bool, typer.Option("--json", help="Print all of it as JSON.")] = False,
    errors: Annotated[
        bool,
        typer.Option(
            "--errors", help="For an emulator: measure where it is weak, in a few seconds."
        ),
    ] = False,
    data: Annotated[
        str | None, typer.Option(help="With --errors, for recordings: the dataset folder or URL.")
    ] = None,
    system: Annotated[
        Path | None,
        typer.Option(
            help="With --errors: your TOML file, whose model or step function is then used."
        ),
    ] = None,
) -> None:
    """Check an emulator, a policy or a dataset and show what it is; --json prints everything, with every column."""
    if errors:
        _show_errors(file, data, system, json=json)
        return
    if is_url(file) or Path(file).is_dir():
        show_dataset(place_of(file), json=json)
        return
    show = _policy if file.endswith(".policy.safetensors") else _emulator
    with phase("loading"):
        everything, rows = show(file)
    if json:
        print(dumps(everything, indent=2, sort_keys=True))
    else:
        print_rows(rows)


def _show_errors(file: str, data: str | None, system: Path | None, *, json: bool) -> None:
    """Print where an emulator is good and where it is weak."""
    if Path(file).is_dir():
        raise ArgumentError(
            f"errors: wanted an emulator, got the folder {file}. Without --errors, 'info' says what the data cover."
        )
    with phase("loading"):
        if system:
            trust_files(system)
        emulator = Emulator.load(find_emulator(file))
        transitions = open_to_measure(data) if data else None
    found = inspect(emulator, data=transitions)
    if json:
        print(dumps(found.to_json(), indent=2, sort_keys=True))
        return
    print_components(found)
    print()
    print_weak_spots(found)


def _emulator(file: str) -> tuple[dict[str, Any], Rows]:
    """Return (all metadata of an emulator, the rows to show)."""
    path = find_emulator(file)
    tensors, metadata = read_tensors(path, "emulator")
    emulator = emulator_from(path, tensors, metadata, Emulator)
    network = metadata["network"]
    widths = "x".join(map(str, network["widths"]))
    strides = ""
    if metadata.get("strides", 1) > 1:
        strides = f", {metadata['strides']} times in a super step"
    stored_numbers = sum(array.size for array in tensors.values())
    astray = "not measured; na.fit_error_bounds(emulator) measures it"
    if emulator.calibration is not None:
        astray = bounds_in_words(emulator.calibration, emulator.dt)
    rows: Rows = [
        ("file", path.name),
        ("system", metadata["system"]),
        ("super step", f"{metadata['dt'] * 1e3:g} ms ({metadata['substeps']} physics steps)"),
        ("state", summary_of(_moving(emulator))),
        *_parameter_rows(emulator),
        ("control", summary_of(emulator.control)),
        ("control bounds", bounds_of(*metadata["bounds"])),
        ("network", f"{network['kind']} {widths}{strides}"),
        ("numbers stored", f"{stored_numbers:,}"),
        ("verdict", emulator.verdict or UNJUDGED),
        ("drifts", astray),
        ("runs in", backend_in_words()),
        ("sha256", metadata["sha256"]),
        ("where it is weak", "--errors measures it, in a few seconds"),
    ]
    return metadata, rows


def _moving(emulator: Emulator) -> Layout:
    """Return the parts of the state that are not parameters."""
    names = {parameter.name for parameter in emulator.parameters}
    return Layout(tuple(part for part in emulator.state.slices if part.name not in names))


def _parameter_rows(emulator: Emulator) -> Rows:
    """Return a row for each parameter of a family: its range and its default value."""
    return [
        (
            f"parameter {parameter.name}",
            f"{parameter.low:.4g} to {parameter.high:.4g} {parameter.unit}, usually {parameter.nominal:.4g}",
        )
        for parameter in emulator.parameters
    ]


def _policy(file: str) -> tuple[dict[str, Any], Rows]:
    """Return (all metadata of a policy, the rows to show)."""
    path = find_policy(file)
    policy, metadata = read_policy_file(path, Policy, StatePolicy)
    if isinstance(policy, StatePolicy):
        return metadata, _state_policy_rows(path, policy, metadata)
    emulator = metadata["emulator"]
    step = f"{emulator['system']}, n = {emulator['substeps']}: a command every {emulator['dt'] * 1e3:g} ms"
    rows: Rows = [
        ("file", path.name),
        ("policy for", step),
        ("command", summary_of(Layout.from_json(metadata["command"], "command"))),
        ("command bounds", bounds_of(*metadata["ranges"])),
        ("control", summary_of(Layout.from_json(emulator["control"], "control"))),
        ("network", "x".join(map(str, metadata["widths"]))),
        ("sha256", metadata["sha256"]),
    ]
    return metadata, rows


def _state_policy_rows(path: Path, policy: StatePolicy, metadata: Metadata) -> Rows:
    """Return the rows to show for a policy of `neuroanimator policy`."""
    emulator = policy.emulator
    return [
        ("file", path.name),
        ("policy for", f"{emulator.system}, a control every {emulator.dt * 1e3:g} ms"),
        ("shown", f"{len(policy.view.entries)} of {emulator.state.size} numbers of the state"),
        ("control", summary_of(emulator.control)),
        ("network", "x".join(map(str, metadata["widths"]))),
        ("sha256", metadata["sha256"]),
        ("returns", f"neuroanimator evaluate {path.name} --episodes 100"),
    ]


NOTHING_DRIVES_IT = "none: nothing drives it"
"""Text for an empty control."""


def summary_of(layout: Layout) -> str:
    """Return the size of a layout and its parts with their units: the first few by name, the rest as a count."""
    if not layout.size:
        return NOTHING_DRIVES_IT
    parts = []
    for part in layout.slices:
        text = f"{part.name} [{part.unit}]"
        if part.size > 1:
            text += f" x {part.size}"
        parts.append(text)
    left_out = len(parts) - MAX_PARTS
    if left_out > 1:
        parts = [*parts[:MAX_PARTS], f"and {left_out} more parts (--json names them)"]
    plural = "s" if layout.size != 1 else ""
    return f"{layout.size} number{plural}: {', '.join(parts)}"


def bounds_of(low: list[float], high: list[float]) -> str:
    """Return the bounds of each number, or only one pair if all are equal."""
    pairs = [f"{least:g} to {largest:g}" for least, largest in zip(low, high, strict=True)]
    are_alike = len(set(pairs)) == 1
    if len(pairs) > 1 and are_alike:
        return f"{pairs[0]}, each"
    return ", ".join(pairs)
