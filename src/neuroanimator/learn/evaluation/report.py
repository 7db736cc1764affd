"""`report.html`: one self-contained file with the figures, the plots and what they mean."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from neuroanimator.emulator.verdict import beyond_noise
from neuroanimator.learn.evaluation import figures
from neuroanimator.learn.evaluation.evaluate import Evaluation
from neuroanimator.learn.evaluation.page import render, write_page
from neuroanimator.learn.evaluation.weakness import tables
from neuroanimator.learn.training.train import METRICS, read_metrics, run_folder
from neuroanimator.terminal import TableRows


def write_report(
    evaluations: Sequence[Evaluation],
    path: str | Path,
    *,
    extra: Sequence[tuple[str, str]] = (),
) -> None:
    """Write the report of `evaluations`; `extra` adds (title, HTML) sections before the details."""
    write_page(
        path,
        "report.html",
        evaluations=evaluations,
        extra=[(title, Markup(body)) for title, body in extra],
        figures=figures,
        tables=tables,
        noise_rows=noise_rows,
    )


def training_html(emulator: Path) -> Markup:
    """Return the curve of the training that made the file `emulator`, or a line that says that it is unknown."""
    path = run_folder(emulator) / METRICS
    file = f"{path.parent.name}/{path.name}"
    return render("training.html", reports=read_metrics(path), file=file, figures=figures)


def noise_rows(evaluation: Evaluation) -> TableRows:
    """Return the recordings' noise and its part of the error, number by number."""
    assert evaluation.noise is not None
    assert evaluation.noise_by_entry is not None
    errors = zip(evaluation.error_by_entry, evaluation.noise_by_entry, strict=True)
    rows: TableRows = []
    for name, deviation in zip(evaluation.entries, evaluation.noise, strict=True):
        if name in evaluation.still:
            continue
        error, by_noise = next(errors)
        rows.append(
            {
                "number of the state": name,
                "noise [its unit]": deviation,
                "one-step error": error,
                "by noise alone": by_noise,
                "left to gain": beyond_noise(error, by_noise),
            }
        )
    return rows
