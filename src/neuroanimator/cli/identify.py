"""The verb `identify`: parameters of a body from recordings of its motion."""

from __future__ import annotations

from json import dumps
from pathlib import Path
from typing import Annotated

import typer

from neuroanimator.cli.shared_options import OwnPhysics, Resample
from neuroanimator.emulator.emulator import Emulator, load_emulator
from neuroanimator.emulator.trust_summary import UNJUDGED
from neuroanimator.learn.identification.identify import Identification, identify
from neuroanimator.learn.identification.report import (
    estimate_row,
    fit_rows,
    write_identification_report,
)
from neuroanimator.physics.loading import trust_files
from neuroanimator.terminal import Rows, phase, print_rows, print_table
from neuroanimator.text import print_line

EXAMPLE = "neuroanimator identify arm.emulator.safetensors --from recording.csv --report arm.html"


def run(
    emulator: Annotated[str, typer.Argument(help="Emulator of a family; see [parameters].")],
    from_: Annotated[
        list[Path],
        typer.Option("--from", help="Recording, CSV or NPZ; may be given several times."),
    ],
    delay: Annotated[
        bool, typer.Option("--delay", help="Find the delay of the measurements, too.")
    ] = False,
    offsets: Annotated[
        bool, typer.Option("--offsets", help="Find the offset of each sensor, too.")
    ] = False,
    window: Annotated[
        float | None, typer.Option(help="Length of windows [s]; 16 super steps if not given.")
    ] = None,
    resample: Resample = False,
    system: OwnPhysics = None,
    no_physics: Annotated[
        bool,
        typer.Option("--no-physics", help="Do not correct or verify the result on the physics."),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(help="File for the emulator at these parameters.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="HTML file with curves.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Find the parameters of a body, with their uncertainty, from recordings of its motion.

    Gauss-Newton steps through the emulator fit windows of the recordings, along with their starts; the result is corrected
    and verified on the physics. A recording need not hold the whole state.
    """
    with phase("loading"):
        if system:
            trust_files(system)
        model = load_emulator(emulator)
    result = identify(
        model,
        from_,
        delay=delay,
        offsets=offsets,
        window=window,
        physics=not no_physics,
        resample=resample,
    )
    if out:
        model.at(**result.parameters).save(out)
    rows = _rows(model, result, out, report)
    if report:
        write_identification_report(report, result, rows)
    if json:
        print(dumps(_as_json(result), indent=2))
        return
    print_table([estimate_row(estimate) for estimate in result.estimates])
    print_table(fit_rows(result))
    print_rows(rows)
    for note in result.notes:
        print_line(note)


def _rows(model: Emulator, result: Identification, out: Path | None, report: Path | None) -> Rows:
    measurements = result.measurements
    proof = "none: no physics is available, so the result rests on the emulator alone"
    if result.proven is not None:
        proof = f"{result.seconds_of_physics:.1f} s, {result.proven.iterations} steps in all"
    rows: Rows = [
        ("body", model.system),
        ("verdict", model.verdict or UNJUDGED),
        ("recordings", ", ".join(measurements.files)),
        (
            "windows",
            f"{len(measurements.controls)} of {measurements.steps * model.dt:g} s, {measurements.steps} super steps",
        ),
        (
            "through the emulator",
            f"{result.seconds_of_emulator:.1f} s, {result.emulated.iterations} steps",
        ),
        ("verified on physics", proof),
    ]
    if out:
        rows.append(("emulator", out))
    if report:
        rows.append(("report", report))
    return rows


def _as_json(result: Identification) -> dict[str, object]:
    """Return the result as JSON values."""
    parameters = {}
    sensors = {}
    for estimate in result.estimates:
        numbers = {
            "value": estimate.value,
            "std": estimate.deviation,
            "unit": estimate.unit,
            "is_known": estimate.is_known,
        }
        target = parameters if estimate.is_parameter else sensors
        target[estimate.name] = numbers
    return {
        "parameters": parameters,
        "sensors": sensors,
        "confused": [list(names) for names in result.confused],
        "notes": list(result.notes),
        "is_proven": result.proven is not None,
        "fits": fit_rows(result),
    }
