"""The curve of a training is drawn from what training wrote, and is missing in words where that is missing."""

from __future__ import annotations

import json
from pathlib import Path

from matplotlib.figure import Figure

from neuroanimator.learn.evaluation.figures import draw_training
from neuroanimator.learn.evaluation.report import training_html
from neuroanimator.learn.training.train import Report, read_metrics, run_folder


def test_the_curve_of_a_training_is_what_it_reported(tmp_path: Path):
    out = tmp_path / "small.emulator.safetensors"
    reports = [
        Report(
            update=500 * number,
            loss=1 / number,
            error=2 / number,
            unrolled_error=3 / number,
            seconds=0.1,
        )
        for number in range(1, 4)
    ]
    run_folder(out).mkdir()
    metrics = run_folder(out) / "metrics.jsonl"
    lines = [json.dumps(report._asdict()) for report in reports]
    metrics.write_text("\n".join([*lines, '{"update": 17, "loss"']))  # the last one is torn
    assert read_metrics(metrics) == reports
    axes = Figure().add_subplot()
    draw_training(axes, reports)
    updates, errors = axes.lines[0].get_data()
    assert list(updates) == [500, 1000, 1500]
    assert list(errors) == [2, 1, 2 / 3]
    assert "<p>1,500 updates." in training_html(out)
    assert training_html(out).count("<svg class=plot") == 1


def test_an_emulator_that_came_alone_has_no_curve_and_says_so(tmp_path: Path):
    told = training_html(tmp_path / "<b>.safetensors")
    assert told.startswith("<p>No curve: &lt;b&gt;.run/metrics.jsonl does not lie beside")
