"""The verb `train`: fit an emulator to a dataset."""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from neuroanimator.cli.generate import ensure_data, tell_shortcomings
from neuroanimator.cli.usage import SECONDS_A_MINUTE, check_minutes, whole_numbers
from neuroanimator.cli.worker_options import Where, Workers, chosen_executor
from neuroanimator.emulator.artifact import first_line, read_metadata, save
from neuroanimator.emulator.departures import departures_in_words, find_departures
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.error_bounds import bounds_in_words
from neuroanimator.emulator.networks import NETWORKS
from neuroanimator.emulator.verdict import CONSTANT_VELOCITY, GOOD, IN_WORDS, NO_CHANGE, Verdict
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.export.programs.formats import POLICY_ENDING
from neuroanimator.files.atomic import canonical_json, read_bounded, write_whole
from neuroanimator.files.json_text import parse_json_object
from neuroanimator.files.numbers import whole
from neuroanimator.files.tables import read_toml
from neuroanimator.learn.budget import DATA_SHARE, updates_within
from neuroanimator.learn.data.shortcomings import shortcomings
from neuroanimator.learn.data.store import Dataset
from neuroanimator.learn.data.stored import open_transitions
from neuroanimator.learn.evaluation.fleets.fleet_file import is_fleet, read_fleet
from neuroanimator.learn.evaluation.fleets.train_fleet import TABLE, train_fleet
from neuroanimator.learn.evaluation.weakness.causes import causes_in_training
from neuroanimator.learn.training.config import MAX_UPDATES, UPDATES_PER_CHUNK, TrainingConfig
from neuroanimator.learn.training.error_fitting import fit_error_bounds
from neuroanimator.learn.training.train import METRICS, Report, run_folder, train
from neuroanimator.terminal import (
    Rows,
    TableRows,
    phase,
    print_rows,
    print_table,
    progress_bar,
    tell,
)

EXAMPLE = "neuroanimator train data/pendulum --out pendulum.emulator.safetensors"

NETWORK_HELP = f"One of {', '.join(NETWORKS)}; the first is the default, classic that of 1998."
"""The help of `--network`."""

PLAN = "plan.json"
"""Name of the file in a run's folder with what --minutes chose, so that a stopped run goes on."""

MAX_PLAN = 1_000
"""Maximum length of that file [bytes]."""

EPISODES = 100
"""Number of episodes that judge a policy inside an emulator trained on its motions."""

PERCENT = 100

SHOWN_DIGITS = 12
"""Number of digits of a sha256 that are printed; the table's file has all."""


def run(
    data: Annotated[
        str,
        typer.Argument(
            help="Folder or URL made by 'generate', a system, your own TOML file, or a fleet's; or a policy file."
        ),
    ],
    out: Annotated[
        Path, typer.Option(help="File for the emulator, or for the policy; folder of a fleet.")
    ],
    config: Annotated[
        Path | None, typer.Option(help="TOML file with any of the settings below.")
    ] = None,
    network: Annotated[str | None, typer.Option(help=NETWORK_HELP)] = None,
    widths: Annotated[
        str | None, typer.Option(help="Units in each layer: 96,64; for a hierarchy 64,0,24.")
    ] = None,
    optimizer: Annotated[
        str | None, typer.Option(help="soap (default), adam, or momentum as in 1998.")
    ] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Maximum learning rate.")] = None,
    updates: Annotated[
        int | None,
        typer.Option(
            help="Weight updates (default 8000, half a minute; with contacts 10000, a few minutes)."
        ),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(
            help="Minutes for data and training together, instead of --updates: a pilot measures what fits into them."
        ),
    ] = None,
    batch: Annotated[int | None, typer.Option(help="Super steps in a minibatch.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of weights, split and batches.")] = None,
    memory: Annotated[
        str | None,
        typer.Option(help="Maximum memory for data (default 8GB); larger data is read from disk."),
    ] = None,
    error_bounds: Annotated[
        bool,
        typer.Option(
            "--error-bounds",
            help="Also measure how far rollouts drift, on new runs of the physics; takes about a minute.",
        ),
    ] = False,
    system: Annotated[
        Path | None,
        typer.Option(help="For a policy file: your TOML file, whose model is then used."),
    ] = None,
    workers: Workers = None,
    executor: Where = "local",
) -> None:
    """Train an emulator; for a system or a TOML file the data is generated first. Or train a fleet, see docs/scale.md.

    For a policy file, train the policy's own emulator, on the policy's motions on the physics; needs the extra [gym].

    If killed, run it again: it resumes, and ends with the same bytes.
    """
    began = time.monotonic()
    settings = _settings(
        config,
        network=network,
        widths=widths,
        optimizer=optimizer,
        learning_rate=learning_rate,
        updates=updates,
        batch=batch,
        seed=seed,
        memory=memory,
    )
    if minutes is not None:
        _check_budget(minutes, data, settings)
    if is_fleet(Path(data)):
        if error_bounds:
            raise ArgumentError(
                "error-bounds: not for a fleet. Leave it out; na.fit_error_bounds(emulator) measures one emulator."
            )
        train_fleet_file(Path(data), out, settings, executor, workers)
        return
    if data.endswith(POLICY_ENDING):
        if error_bounds:
            raise ArgumentError(
                "error-bounds: they are measured under random controls, not a policy's. Leave it out."
            )
        train_in_policy(Path(data), out, settings, toml=system)
        return
    if system is not None:
        raise ArgumentError("system: applies to policy files only. Leave it out.")
    memory_limit = TrainingConfig(
        **settings
    ).memory  # wrong settings are refused before data is made
    seconds = None if minutes is None else SECONDS_A_MINUTE * minutes
    with chosen_executor(executor, workers) as spread:
        place = ensure_data(data, out, spread, None if seconds is None else DATA_SHARE * seconds)
    transitions = open_transitions(place, memory_limit)
    tell_shortcomings(transitions.config, shortcomings(transitions))
    checked = TrainingConfig.usual(transitions.system.structure, **settings)
    if seconds is not None:
        checked = _planned(transitions, checked, out, seconds - (time.monotonic() - began))
    emulator, last = _train_with_bar(transitions, checked, out)
    rows = _rows(emulator, last, out, _judged(emulator, transitions, checked))
    if error_bounds:
        rows.append(("drifts", _bound_errors(emulator, transitions, out)))
    print_rows(rows)


def _check_budget(minutes: float, data: str, settings: dict[str, Any]) -> None:
    """Refuse a time that is none, that also has a number of updates, or that is not for one emulator."""
    check_minutes(minutes)
    if "updates" in settings:
        raise ArgumentError("minutes: they decide the number of updates. Leave one of both out.")
    if is_fleet(Path(data)) or data.endswith(POLICY_ENDING):
        raise ArgumentError("minutes: not for fleets and policies. Give --updates.")


def _planned(data: Dataset, config: TrainingConfig, out: Path, seconds: float) -> TrainingConfig:
    """Return the settings with as many updates as fit into `seconds`; those of a stopped run, which goes on."""
    plan = run_folder(out) / PLAN
    if plan.exists():
        try:
            told = parse_json_object(read_bounded(plan, MAX_PLAN).decode(), MAX_PLAN)
            updates = whole(told.get("updates"), "updates", UPDATES_PER_CHUNK, MAX_UPDATES)
        except ValueError as error:
            raise BadFileError(f"{plan}: {first_line(error)}. Remove it.") from error
    else:
        with phase("timing updates"):
            updates = updates_within(data, config, seconds)
        plan.parent.mkdir(parents=True, exist_ok=True)
        write_whole(plan, canonical_json({"updates": updates}).encode())
    tell(f"training for {updates:,} updates (usually {config.updates:,})")
    return config.model_copy(update={"updates": updates})


def train_in_policy(
    path: Path,
    out: Path,
    settings: dict[str, Any],
    *,
    count: int | None = None,
    toml: Path | None = None,
) -> None:
    """Train the emulator of the policy in the file `path` on the policy's motions, and write the policy with it to `out`.

    The policy's return in it is printed beside that on the physics: one-step errors do not tell whether a body falls.
    """
    with phase("loading"):
        from neuroanimator.cli.policy_returns import evaluate_policy, loaded_policy  # needs [gym]
        from neuroanimator.gym.policy_transitions import COUNT, TRAINING, policy_transitions

    count = count or COUNT
    if not out.name.endswith(POLICY_ENDING):
        raise ArgumentError(f"out: wanted a name that ends in {POLICY_ENDING}, got {out.name}.")
    policy, system, task = loaded_policy(path, toml)
    with progress_bar("simulating the policy", PERCENT) as bar:
        data = policy_transitions(
            policy,
            task,
            system,
            count=count,
            on_share=lambda share: bar.advance_to(round(PERCENT * share)),
        )
    config = TrainingConfig.usual(system.structure, **(TRAINING | settings))
    folder = run_folder(out)
    folder.mkdir(parents=True, exist_ok=True)
    place = folder / f"{system.name}.emulator.safetensors"
    emulator, last = _train_with_bar(data, config, place)
    verdict = _judged(emulator, data, config)
    trained = replace(policy, emulator=emulator)
    trained.save(out, {"emulator": config.model_dump(mode="json")})
    print_rows(
        [
            ("trained on", f"{count:,} super steps of its motions"),
            *_rows(emulator, last, place, verdict),
        ]
    )
    evaluate_policy(out, toml, EPISODES, 0, as_json=False)


def _settings(config: Path | None, widths: str | None, **options: object) -> dict[str, Any]:
    """Return the settings of the file, overridden by the options that were given."""
    settings: dict[str, Any] = {}
    if config:
        settings = read_toml(config)
    if widths is not None:
        options["widths"] = whole_numbers("widths", widths)
    given = {key: value for key, value in options.items() if value is not None}
    return settings | given


def _train_with_bar(
    data: Dataset, config: TrainingConfig, out: Path
) -> tuple[Emulator, Report | None]:
    """Return the emulator and the last report; None for a training that was already done."""
    last: Report | None = None
    note = ""
    with progress_bar("updates", config.whole_updates) as bar:

        def on_chunk(updates: int) -> None:
            bar.advance_to(updates, note)

        def on_report(report: Report) -> None:
            nonlocal last, note
            last = report
            updates_per_second = report.update / report.seconds
            note = f"error {report.error:.4f}, {updates_per_second:,.0f}/s"
            bar.advance_to(report.update, note)

        emulator = train(data, config, out, on_report=on_report, on_chunk=on_chunk)
    return emulator, last


def _judged(emulator: Emulator, data: Dataset, config: TrainingConfig) -> Verdict:
    """Return the verdict on an emulator trained on `data`, with the causes of its faults."""
    verdict = emulator.verdict
    assert verdict is not None
    if verdict.word == GOOD:
        return verdict
    with phase("looking for causes"):
        return verdict.because(causes_in_training(emulator, data, config))


def _rows(emulator: Emulator, last: Report | None, out: Path, verdict: Verdict) -> Rows:
    """Return the rows to print about a training."""
    rows: Rows = [
        ("emulator", out),
        ("metrics", run_folder(out) / METRICS),
    ]
    if last is not None:
        rows.append(("updates", last.update))
    errors = emulator.validation
    assert errors is not None
    with phase("holding the controls"):
        departures = find_departures(emulator)
    return [
        *rows,
        ("one-step error (validation)", f"{float(errors.emulator):.4f}"),
        (IN_WORDS[NO_CHANGE], f"{float(errors.no_change):.4f}"),
        (IN_WORDS[CONSTANT_VELOCITY], f"{float(errors.constant_velocity):.4f}"),
        ("verdict", verdict),
        ("controls that are held", departures_in_words(departures)),
    ]


def _bound_errors(emulator: Emulator, data: Dataset, out: Path) -> str:
    """Measure how far rollouts go astray, add it to the file `out`, and return it in words."""
    with phase("measuring how far rollouts drift"):
        bounded = fit_error_bounds(emulator, data)
    save(bounded, out, read_metadata(out)["provenance"])
    assert bounded.calibration is not None
    return bounds_in_words(bounded.calibration, bounded.dt)


def train_fleet_file(
    file: Path, out: Path, settings: dict[str, Any], executor: str, workers: int | None
) -> None:
    """Train the fleet that `file` describes, and print its table; `settings` of one emulator are refused."""
    if settings:
        names = ", ".join(sorted(settings))
        raise ArgumentError(
            f"{file} is a fleet: set {names} in its sizes, not on the command line."
        )
    fleet = read_fleet(file)
    with (
        chosen_executor(executor, workers) as spread,
        progress_bar("emulators", len(fleet.members)) as bar,
    ):

        def on_start(count: int) -> None:
            bar.advance_to(len(fleet.members) - count)

        rows = train_fleet(fleet, out, spread, on_start=on_start, on_member=bar.advance)
    table: TableRows = []
    for row in rows:
        figures = asdict(row)
        figures["sha256"] = row.sha256[:SHOWN_DIGITS]
        table.append(figures)
    print_table(table)
    print_rows([("emulators", out), ("table", out / TABLE)])
