"""The verb `generate`: make a dataset of transitions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from neuroanimator.cli.worker_options import Where, Workers, chosen_executor
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.executor.executor import Executor
from neuroanimator.files.places import FLEETING_SCHEME, Place, UrlPath, is_url, place_of
from neuroanimator.files.sources import refuse_source
from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.learn.budget import transitions_within
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.diverged_runs import PATTERN
from neuroanimator.learn.data.generate import generate
from neuroanimator.learn.data.recorded_segments import limited_to_recordings
from neuroanimator.learn.data.shortcomings import shortcomings_of
from neuroanimator.learn.data.store import read_config
from neuroanimator.physics import carried_system
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.terminal import Rows, phase, print_rows, progress_bar, tell, warn_once

EXAMPLE = (
    "neuroanimator generate pendulum --substeps 50 --count 100000 --seed 0 --out data/pendulum"
)


def run(
    system: Annotated[
        str,
        typer.Argument(help="System to simulate, see 'list'; or your own TOML file, see 'new'."),
    ],
    out: Annotated[str, typer.Option(help="Folder for the shards, or a URL: s3://bucket/folder.")],
    substeps: Annotated[
        int | None,
        typer.Option(help="Physics steps n in a super step; default: the system's own, or 50."),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option(help="Number of transitions; default 300,000, or 12,288 for a soft body."),
    ] = None,
    samples_per_run: Annotated[
        int | None,
        typer.Option(
            help="Transitions per simulated run: 12, 18, 24 or 36; default 36, or 12 for a soft body."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of starts and controls.")] = 0,
    threads: Annotated[
        int | None,
        typer.Option(
            help="Threads of each worker; 0 or not given: all cores. The result does not depend on it."
        ),
    ] = None,
    workers: Workers = None,
    executor: Where = "local",
) -> None:
    """Simulate random motions and store transitions. If killed, run it again: it resumes where it stopped."""
    with phase("loading"):
        if system.endswith(".toml"):
            trust_files(system)
        name, definition, usual_substeps = resolve(system)
    place = place_of(out)
    if isinstance(place, UrlPath) and place.scheme == FLEETING_SCHEME:
        raise ArgumentError(
            f"out: what is put into {place} is lost when this command ends. Give a folder, or a URL such as "
            "s3://bucket/folder."
        )
    if substeps is None:
        substeps = usual_substeps
    settings: dict[str, Any] = {"seed": seed}
    if samples_per_run is not None:
        settings["samples_per_run"] = samples_per_run
    config = DatasetConfig.usual(name, definition, substeps, count=count, **settings)
    config = _checked_data(config)
    with chosen_executor(executor, workers, threads) as spread:
        diverged = generate_with_bar(config, place, spread)
    rows: Rows = [
        ("transitions", (config.runs - diverged) * config.samples_per_run),
        ("runs diverged and dropped", diverged),
    ]
    if diverged:
        rows.append(("kept for replay in", place / PATTERN))
    rows += [("shards", config.shards), ("folder", place)]
    print_rows(rows)


def _checked_data(config: DatasetConfig) -> DatasetConfig:
    """Return what `config` asks for and recordings hold; what such data lack is said."""
    with phase("loading"):
        system = carried_system(config.system, config.definition)
        config = limited_to_recordings(config, system)
    tell_shortcomings(config, shortcomings_of(config, system))
    return config


def tell_shortcomings(config: DatasetConfig, lacking: list[str]) -> None:
    """Say on stderr what the data of `config` are `lacking`."""
    for text in lacking:
        warn_once(f"{config.system}: {text}.")


def generate_with_bar(
    config: DatasetConfig,
    out: Place,
    executor: Executor | None = None,
) -> int:
    """Fill `out` with the dataset under a progress bar; return the number of runs that diverged, which are left out."""
    with progress_bar("shards", config.shards) as bar:
        return generate(config, out, executor=executor, on_shard=bar.advance)


def ensure_data(
    reference: str,
    emulator: Path,
    executor: Executor | None = None,
    seconds: float | None = None,
) -> Place:
    """Return the dataset folder or URL `reference`, or one made beside `emulator` for the system or TOML file it names.

    With `seconds`, new data are as many as can be made in that time.
    """
    if is_url(reference):
        return place_of(reference)
    if Path(reference).is_dir():
        return Path(reference)
    if reference not in SHIPPED_SYSTEMS and not reference.endswith(".toml"):
        refuse_source(reference, "dataset, system or TOML file")
        raise BadFileError(
            f"{reference} is not a dataset folder, nor a system ({', '.join(SHIPPED_SYSTEMS)}), nor a TOML file. "
            "Make a dataset with 'generate'."
        )
    if reference.endswith(".toml"):
        trust_files(reference)
    name, definition, usual_substeps = resolve(reference)
    stem = emulator.name.removesuffix(".safetensors").removesuffix(".emulator")
    folder = emulator.with_name(stem + ".data")
    config = _checked_data(DatasetConfig.usual(name, definition, usual_substeps))
    if seconds is not None and folder.is_dir():
        # A stopped command goes on; data of anything else are refused below.
        config = config.model_copy(update={"count": read_config(folder).count})
    elif seconds is not None and carried_system(name, definition).recordings is None:
        with phase("timing the simulation"):
            count = transitions_within(config, seconds)
        config = config.model_copy(update={"count": count})
        tell(f"simulating {count:,} transitions, in about {seconds:.0f} s at most")
    generate_with_bar(config, folder, executor)
    return folder
