"""The verb `evaluate`: measure accuracy and speed of emulators."""

from __future__ import annotations

from dataclasses import asdict
from json import dumps
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from neuroanimator.cli.inspection_output import print_weak_spots
from neuroanimator.cli.shared_options import OwnPhysics
from neuroanimator.cli.usage import whole_numbers
from neuroanimator.cli.worker_options import Where, Workers, chosen_executor
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.executor.executor import Executor
from neuroanimator.files.zoo import find_emulator
from neuroanimator.film.inline import film_html, motion_html
from neuroanimator.film.worst_cases import WORST_TITLE, WORST_WORDS, check_worst_path, write_worst
from neuroanimator.learn.data.stored import open_to_measure
from neuroanimator.learn.evaluation.evaluate import Evaluation, evaluate
from neuroanimator.learn.evaluation.fleets.sweep import largest_within, sweep
from neuroanimator.learn.evaluation.model_card import write_card
from neuroanimator.learn.evaluation.report import training_html, write_report
from neuroanimator.learn.training.trust_fitting import fit_trust
from neuroanimator.physics.loading import trust_files
from neuroanimator.terminal import phase, print_table, progress_bar
from neuroanimator.text import print_line

EXAMPLE = "neuroanimator evaluate pendulum-25 pendulum-50 pendulum-100 --report report.html"


class Files(NamedTuple):
    """Files to write, besides the printed output."""

    report: Path | None
    worst: Path | None
    card: Path | None


class SweepBudget(NamedTuple):
    """Settings of a sweep, and the budget for each n."""

    tolerance: float
    seconds: float
    transitions: int
    updates: int


def run(
    emulators: Annotated[
        list[str], typer.Argument(help="Emulator files or names; a system with --sweep.")
    ],
    data: Annotated[
        str | None,
        typer.Option(help="Dataset folder or URL, to compare with cheap predictors, too."),
    ] = None,
    system: OwnPhysics = None,
    report: Annotated[Path | None, typer.Option(help="HTML file with plots.")] = None,
    worst: Annotated[
        Path | None,
        typer.Option(help="Worst cases: a film in .mp4, also in the report; curves in .svg, .png."),
    ] = None,
    card: Annotated[
        Path | None, typer.Option(help="Markdown file: a model card of the only emulator.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print rows as JSON.")] = False,
    sweep: Annotated[
        bool, typer.Option("--sweep", help="Train emulators of several n and compare them.")
    ] = False,
    substeps: Annotated[str, typer.Option(help="Sweep: the n to try.")] = "25,50,100",
    tolerance: Annotated[
        float, typer.Option(help="Sweep: maximum error, as a share of how far a run gets.")
    ] = 0.1,
    seconds: Annotated[
        float, typer.Option(help="Sweep: time after which the error is measured [s].")
    ] = 1.0,
    count: Annotated[int, typer.Option(help="Sweep: number of transitions for each n.")] = 50_000,
    updates: Annotated[
        int, typer.Option(help="Sweep: number of weight updates for each n.")
    ] = 20_000,
    out: Annotated[Path, typer.Option(help="Sweep: folder for data and emulators.")] = Path(
        "out/sweep"
    ),
    episodes: Annotated[int, typer.Option(help="For a policy: number of episodes.")] = 100,
    seed: Annotated[int, typer.Option(help="For a policy: seed of the starts.")] = 0,
    workers: Workers = None,
    executor: Where = "local",
) -> None:
    """Measure the accuracy of emulators on unseen runs of fine physics, and their speed; or choose n by --sweep.

    For a policy made by 'policy', measure its returns.
    """
    if any(name.endswith(".policy.safetensors") for name in emulators):
        if len(emulators) > 1:
            raise ArgumentError(f"evaluate: wanted one policy, got {len(emulators)} files.")
        with phase("loading"):
            from neuroanimator.cli.policy_returns import evaluate_policy  # needs the extra [gym]

        evaluate_policy(Path(emulators[0]), system, episodes, seed, as_json=json, report=report)
        return
    if sweep:
        budget = SweepBudget(tolerance, seconds, count, updates)
        with chosen_executor(executor, workers) as spread:
            _sweep(emulators, substeps, budget, out, json, spread)
    else:
        _evaluate(emulators, data, system, Files(report, worst, card), json)


def _evaluate(
    emulators: list[str], data: str | None, system: Path | None, files: Files, json: bool
) -> None:

    with phase("loading"):
        if system:
            trust_files(system)
        paths = [find_emulator(name) for name in emulators]
        loaded = [Emulator.load(path) for path in paths]
        if files.worst:
            check_worst_path(files.worst)
        if files.card and len(loaded) > 1:
            raise ArgumentError(f"evaluate --card: wanted one emulator, got {len(loaded)}.")
        transitions = open_to_measure(data) if data else None
        if transitions is not None:
            # Older files lack a score; it is fitted to the data.
            loaded = [
                fit_trust(emulator, transitions) if emulator.meter is None else emulator
                for emulator in loaded
            ]
    evaluations = []
    with progress_bar("emulators", len(loaded)) as bar:
        for emulator in loaded:
            evaluations.append(evaluate(emulator, data=transitions))
            bar.advance()
    _write(loaded, paths, evaluations, files)
    if files.card:
        write_card(loaded[0], paths[0], evaluations[0], files.card)
    if json:
        print(dumps([_everything(evaluation) for evaluation in evaluations], indent=2))
    else:
        _print(evaluations)


def _write(
    emulators: list[Emulator], paths: list[Path], evaluations: list[Evaluation], files: Files
) -> None:
    """Write the requested files; the report includes films of each system's motion and of the worst cases."""
    extra: list[tuple[str, str]] = []
    if files.worst:
        inspections = [found.inspection for found in evaluations if found.inspection]
        write_worst(emulators, inspections, files.worst)
        if files.worst.suffix == ".mp4":
            extra.append((WORST_TITLE, film_html(files.worst, WORST_WORDS)))
    if files.report:
        by_system = {emulator.system: emulator for emulator in emulators}
        with progress_bar("drawing motions", len(by_system)) as bar:
            for number, emulator in enumerate(by_system.values()):
                motion = (f"How the {emulator.system} moves", motion_html(emulator))
                extra.insert(number, motion)
                bar.advance()
        for emulator, path in zip(emulators, paths, strict=True):
            title = f"How it was trained: {emulator.system}, n = {emulator.substeps}"
            extra.append((title, training_html(path)))
        write_report(evaluations, files.report, extra=extra)


def _print(evaluations: list[Evaluation]) -> None:
    """Print a row for each emulator, then remarks on each."""
    print_table([dict(evaluation.row()) for evaluation in evaluations])
    for evaluation in evaluations:
        print_line(f"{evaluation.title}: {evaluation.verdict}. {evaluation.note}")
        if evaluation.inspection:
            print_weak_spots(evaluation.inspection)


def _everything(evaluation: Evaluation) -> dict[str, Any]:
    """Return an evaluation's row, and all findings of its inspection."""
    found: dict[str, Any] = dict(evaluation.row())
    if evaluation.inspection:
        found["inspection"] = evaluation.inspection.to_json()
    return found


def _sweep(
    systems: list[str],
    substeps: str,
    budget: SweepBudget,
    out: Path,
    json: bool,
    executor: Executor,
) -> None:

    if len(systems) != 1:
        raise ArgumentError(
            f"evaluate --sweep: wanted one system or TOML file, got {len(systems)}."
        )
    counts = whole_numbers("substeps", substeps)
    with progress_bar("n", len(counts)) as bar:
        rows = sweep(
            systems[0],
            counts,
            out,
            seconds=budget.seconds,
            transitions=budget.transitions,
            updates=budget.updates,
            executor=executor,
            on_row=bar.advance,
        )
    best = largest_within(rows, budget.tolerance)
    table = []
    for row in rows:
        figures = asdict(row)
        figures["path"] = str(row.path)
        table.append(figures)
    if json:
        print(dumps(table, indent=2))
        return
    print_table(table)
    verdict = "none of them; train longer, or use smaller n"
    if best:
        verdict = f"n = {best.substeps}"
    print(
        f"Largest n whose error after {budget.seconds:g} s is at most {budget.tolerance:g}: {verdict}."
    )
