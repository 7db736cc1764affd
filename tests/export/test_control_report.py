"""The report of a controller says what was done, and stands alone."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup

import neuroanimator as na
from neuroanimator import DescentOptions, Emulator, Synthesis
from neuroanimator.film.control_report import control_html, write_control_report
from neuroanimator.film.graphics import graphics_backend


@pytest.fixture(scope="module")
def synthesis(shipped: Emulator) -> Synthesis:
    system = na.load_system("pendulum")
    objective = na.Objective.of(na.effort(), na.goal(system, "upright"))
    options = na.SearchOptions(DescentOptions(iterations=6), corrections=1)
    return na.synthesise(shipped, system, objective, system.rest, steps=12, options=options)


def test_every_iteration_of_every_descent_is_counted(synthesis: Synthesis):
    courses = synthesis.spent.courses
    assert courses[0] == synthesis.descent.costs
    assert sum(len(course) - 1 for course in courses) == synthesis.spent.iterations
    assert len(courses) >= 1 + synthesis.spent.corrections
    for course in courses:
        assert course[-1] <= course[0]


def test_the_report_of_a_controller_shows_the_motion_the_descent_and_the_controls(
    synthesis: Synthesis, tmp_path: Path
):
    path = tmp_path / "report.html"
    write_control_report(synthesis, path, asked=[("start", "at <rest>")])
    page = path.read_text()
    assert "at &lt;rest&gt;" in page
    for words in ("J over the iterations", "Controls over time", "Errors of the emulator"):
        assert f"<h3>{words}</h3>" in page
    assert f"{synthesis.outcome.cost_physics:.3f}" in page
    assert page.count("<svg class=plot") == 2
    assert page.count("<video") == (graphics_backend() is not None)
    assert re.search(r"Made \d{4}-\d\d-\d\d .* by NeuroAnimator", page)
    assert not re.search(r'(src|href)="https?://', page.replace('xlink:href="#', ""))


def test_the_table_of_errors_is_of_what_was_measured(synthesis: Synthesis):
    outcome = synthesis.outcome
    apart = outcome.emulator_states - outcome.physics_states
    error = np.sqrt((apart**2).mean(axis=0))
    worst = int((error / np.ptp(outcome.physics_states, axis=0)).argmax())
    name = synthesis.emulator.state.names[worst].rpartition(" ")[0]
    table = control_html(synthesis, Markup()).split("Errors of the emulator")[1]
    first = re.findall(r"<tr><td>(.*?)</td><td>.*?</td><td>(.*?)</td>", table)[0]
    assert first[0] == name
    assert float(first[1]) == pytest.approx(error[worst], rel=0.01)
