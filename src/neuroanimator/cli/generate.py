"""`generate`: make a dataset of transitions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EXAMPLE = "neuroanimator generate pendulum --substeps 50 --count 100000 --seed 0 --out data/pendulum"


def run(
    system: Annotated[str, typer.Argument(help="System to simulate, see 'list'; or your own TOML file, see 'new'.")],
    out: Annotated[Path, typer.Option(help="Folder for the shards.")],
    substeps: Annotated[
        int | None, typer.Option(help="Physics steps n in a super step; the system's own, or 50.")
    ] = None,
    count: Annotated[int, typer.Option(help="Transitions to make.")] = 100_000,
    seed: Annotated[int, typer.Option(help="Seed of starts and controls.")] = 0,
    threads: Annotated[
        int | None, typer.Option(help="Threads; default all cores. The bytes do not depend on it.")
    ] = None,
) -> None:
    """Simulate random motions and store transitions. Killed and started again it goes on where it stopped."""
    from neuroanimator.data.generate import generate
    from neuroanimator.data.transitions import PICKS_PER_RUN, dataset_config
    from neuroanimator.systems.own import resolve
    from neuroanimator.terminal import print_rows, progress_bar

    name, definition, usual = resolve(system)
    config = dataset_config(system=name, definition=definition, substeps=substeps or usual, count=count, seed=seed)
    done = 0
    with progress_bar("shards", config.shards) as bar:

        def on_shard() -> None:
            nonlocal done
            done += 1
            bar.advance_to(done)

        blow_ups = generate(config, out, threads=threads, on_shard=on_shard)
    kept = (config.runs - blow_ups) * PICKS_PER_RUN
    print_rows(
        [
            ("transitions", kept),
            ("runs blown up and dropped", blow_ups),
            ("shards", config.shards),
            ("folder", out),
        ]
    )
