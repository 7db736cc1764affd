"""The verb `improve`: learn where an emulator is weak, or from a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from neuroanimator.cli.motion_sources import start_of
from neuroanimator.cli.shared_options import START_HELP, OneEmulator, OwnPhysics
from neuroanimator.cli.usage import refuse_given
from neuroanimator.emulator.emulator import Emulator, load_emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.export.csv_file import read_controls
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.evaluation.weakness.config import ImprovementConfig
from neuroanimator.learn.evaluation.weakness.fine_tune import fine_tune
from neuroanimator.learn.evaluation.weakness.improve import ErrorChange, improve, read_old_data
from neuroanimator.learn.training.train import Report
from neuroanimator.physics.loading import trust_files
from neuroanimator.terminal import TableRows, phase, print_rows, print_table, progress_bar
from neuroanimator.text import print_line

EXAMPLE = (
    "neuroanimator improve pendulum-50 --controls swing-up.csv --out better.emulator.safetensors"
)


def run(
    emulator: OneEmulator,
    out: Annotated[Path, typer.Option(help="File for the improved emulator.")],
    controls: Annotated[
        list[Path] | None,
        typer.Option(
            help="CSV of controls, as 'control' writes: search along its motion, too; may be given several times."
        ),
    ] = None,
    start: Annotated[
        list[str] | None, typer.Option(help=f"With --controls. {START_HELP} Rest if not given.")
    ] = None,
    from_: Annotated[
        Path | None,
        typer.Option(
            "--from", help="Learn from this recording of the real system instead, CSV or NPZ."
        ),
    ] = None,
    resample: Annotated[
        bool,
        typer.Option(
            "--resample", help="Interpolate a recording whose samples are not evenly spaced."
        ),
    ] = False,
    data: Annotated[
        str | None,
        typer.Option(
            help="Folder or URL of the dataset it was trained on; if not given, part of it is simulated anew."
        ),
    ] = None,
    system: OwnPhysics = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Maximum error on every distribution of motions: 95th percentile of one-step errors, in standard deviations "
            "of the usual change. Default: seven tenths of the largest at the start."
        ),
    ] = None,
    rounds: Annotated[
        int | None, typer.Option(help="Maximum number of rounds (default 6).")
    ] = None,
    samples: Annotated[
        int | None, typer.Option(help="Super steps simulated per round (default 6000).")
    ] = None,
    updates: Annotated[
        int | None, typer.Option(help="Weight updates per round (default 6000).")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Random seed.")] = None,
) -> None:
    """Find where an emulator errs or is not to be trusted, simulate there, and train it further; or learn from a recording.

    It keeps what it knew: errors on usual motions are printed before and after. Killed and started again, it goes on
    and ends with the same bytes.
    """
    with phase("loading"):
        options: dict[str, Any] = {"rounds": rounds, "samples": samples}
        options |= {"updates": updates, "seed": seed}
        given = {name: value for name, value in options.items() if value is not None}
        config = ImprovementConfig(**given)
        if system:
            trust_files(system)
        model = load_emulator(emulator)
        old = read_old_data(data, model, config) if data else None
    if from_ is None:
        refuse_given({"resample": resample or None}, "goes with --from only. Leave it out.")
        _improve(model, out, config, old, tolerance, controls or [], start)
        return
    others = {
        "controls": controls,
        "start": start,
        "tolerance": tolerance,
        "rounds": rounds,
        "samples": samples,
    }
    refuse_given(others, "does not go with --from, which simulates nothing. Leave one of them out.")
    _learn_from(model, from_, out, config, old, resample=resample)


def _improve(
    model: Emulator,
    out: Path,
    config: ImprovementConfig,
    old: Transitions | None,
    tolerance: float | None,
    controls: list[Path],
    start: list[str] | None,
) -> None:
    """Improve an emulator where it is weak, under progress bars."""
    if start and not controls:
        raise ArgumentError("start: applies to --controls only. Give --controls, too.")
    controllers = {str(path): read_controls(path, model) for path in controls}
    start_state = start_of(model, start)
    with (
        progress_bar("rounds", config.rounds) as round_bar,
        progress_bar("updates", config.updates) as update_bar,
    ):

        def on_round(number: int, errors: Mapping[str, float]) -> None:
            worst = max(errors, key=lambda name: errors[name])
            round_bar.advance_to(number, f"{worst}: error {errors[worst]:.4f}")

        def on_report(report: Report) -> None:
            update_bar.advance_to(report.update, f"error {report.error:.4f}")

        result = improve(
            model,
            out,
            tolerance=tolerance,
            config=config,
            data=old,
            controllers=controllers,
            start=start_state,
            on_round=on_round,
            on_report=on_report,
        )
    _print(result.errors, ("samples simulated", result.samples), out)
    print_line(f"{model.system}: {result}.")


def _learn_from(
    model: Emulator,
    recording: Path,
    out: Path,
    config: ImprovementConfig,
    old: Transitions | None,
    *,
    resample: bool,
) -> None:
    """Learn from a recording, under a progress bar."""
    with progress_bar("updates", config.updates) as bar:

        def on_report(report: Report) -> None:
            bar.advance_to(report.update, f"error {report.error:.4f}")

        result = fine_tune(
            model, recording, out, config=config, data=old, resample=resample, on_report=on_report
        )
    _print(result.errors, ("windows trained on", result.windows), out)


def _print(errors: tuple[ErrorChange, ...], taken: tuple[str, object], out: Path) -> None:
    """Print the errors before and after, the cost, and the new file."""
    rows: TableRows = []
    for error in errors:
        name = error.distribution
        rows.append({"95 % of errors below": name, "before": error.before, "after": error.after})
    print_table(rows)
    print_rows([taken, ("emulator", out)])
