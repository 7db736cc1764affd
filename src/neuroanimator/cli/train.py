"""The verb `train`: fit an emulator to a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

EXAMPLE = "neuroanimator train data/pendulum --out pendulum.emulator.safetensors"


def run(
    data: Annotated[
        str,
        typer.Argument(help="Folder or URL made by 'generate', a system, or your own TOML file."),
    ],
    out: Annotated[Path, typer.Option(help="File for the emulator.")],
    config: Annotated[
        Path | None, typer.Option(help="TOML file with any of the settings below.")
    ] = None,
    network: Annotated[
        str | None, typer.Option(help="gated (default), classic (1998), hierarchy, glu.")
    ] = None,
    widths: Annotated[
        str | None, typer.Option(help="Units in each layer: 96,64; of a hierarchy 64,0,24.")
    ] = None,
    optimizer: Annotated[
        str | None, typer.Option(help="muon (default), adam, or momentum as in 1998.")
    ] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Highest learning rate.")] = None,
    updates: Annotated[
        int | None,
        typer.Option(
            help="Weight updates (default 40000, half a minute; with contacts 16000, some minutes)."
        ),
    ] = None,
    batch: Annotated[int | None, typer.Option(help="Super steps in a minibatch.")] = None,
    unroll: Annotated[
        int | None, typer.Option(help="Super steps the last updates look ahead, 1 to 4.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of weights, split and batches.")] = None,
    memory: Annotated[
        str | None,
        typer.Option(help="What data may take (default 8GB); what needs more is read from disk."),
    ] = None,
) -> None:
    """Train an emulator; of a system or a TOML file the data is generated first.

    Killed and started again it goes on and ends with the same bytes.
    """
    from neuroanimator.terminal import phase, print_rows, progress_bar

    with phase("loading"):
        from neuroanimator.cli.generate import ensure_data
        from neuroanimator.cli.numbers import whole_numbers
        from neuroanimator.data.stored import open_transitions
        from neuroanimator.evaluation.evaluate import judge_training
        from neuroanimator.tables import read_toml
        from neuroanimator.training.config import UPDATES_PER_CHUNK, TrainingConfig
        from neuroanimator.training.train import Report, run_folder, train

    layer_widths = None
    if widths is not None:
        layer_widths = whole_numbers("widths", widths)
    options = {
        "network": network,
        "widths": layer_widths,
        "optimizer": optimizer,
        "learning_rate": learning_rate,
        "updates": updates,
        "batch": batch,
        "unroll": unroll,
        "seed": seed,
        "memory": memory,
    }
    settings: dict[str, Any] = {}
    if config:
        settings = read_toml(config)
    for key, value in options.items():
        if value is not None:
            settings[key] = value
    memory_limit = TrainingConfig(**settings).memory  # what is wrong is said before data are made
    last: list[Report] = []
    transitions = open_transitions(ensure_data(data, out), memory_limit)
    checked = TrainingConfig.usual(transitions.system.structure, **settings)
    with progress_bar("updates", checked.chunks * UPDATES_PER_CHUNK) as bar:

        def on_report(report: Report) -> None:
            last[:] = [report]
            updates_per_second = report.update / report.seconds
            bar.advance_to(report.update, f"error {report.error:.4f}, {updates_per_second:,.0f}/s")

        emulator = train(transitions, checked, out, on_report=on_report)
    rows: list[tuple[str, object]] = [
        ("emulator", out),
        ("metrics", run_folder(out) / "metrics.jsonl"),
    ]
    if last:
        rows += [
            ("one-step error (validation)", f"{last[0].error:.4f}"),
            ("updates", last[0].update),
        ]
    rows += [("verdict", judge_training(emulator, transitions, checked))]
    print_rows(rows)
