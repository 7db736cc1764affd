"""Learning the physics around a motion takes no longer than it may, and says what it would have needed."""

from __future__ import annotations

import re
import time
from dataclasses import replace

import numpy as np
import pytest
from swing_up import stand_upright

from neuroanimator import (
    DescentOptions,
    Emulator,
    NeuroAnimatorError,
    Refinement,
    SearchOptions,
    load_system,
    synthesise,
)
from neuroanimator.cli.control import _say_gap
from neuroanimator.control.synthesis.attempt import Attempt, Search
from neuroanimator.control.synthesis.summary import outcome_rows
from neuroanimator.control.synthesis.synthesise import Synthesis
from neuroanimator.control.synthesis.synthesise import synthesise as alone
from neuroanimator.learn.finetune import Deadline, OutOfTimeError


@pytest.fixture(scope="module")
def wrong(shipped: Emulator) -> Emulator:
    """An emulator that disagrees with the physics."""
    scale = shipped.normaliser.change_scale
    return replace(shipped, normaliser=replace(shipped.normaliser, change_scale=2 * scale))


def found_within(wrong: Emulator, minutes: float, gaps: list[float]) -> Synthesis:
    return synthesise(
        wrong,
        load_system("pendulum"),
        stand_upright(),
        np.zeros(6),
        steps=20,
        options=SearchOptions(
            DescentOptions(iterations=3),
            corrections=0,
            refine=Refinement(minutes=minutes, on_refine=gaps.append),
        ),
    )


def test_what_would_take_too_long_is_left_out_and_what_allows_it_is_said(wrong: Emulator):
    gaps: list[float] = []
    found = found_within(wrong, 1e-4, gaps)
    assert len(gaps) == 1
    assert found.spent.refinements == 0
    assert found.spent.minutes_wanted > 1e-4
    told = str(dict(outcome_rows(found))["refinements by training"])
    assert re.fullmatch(r"0; another one would have taken too long: --minutes \d+ allows it", told)


def test_without_minutes_nothing_is_learnt_or_announced(wrong: Emulator):
    gaps: list[float] = []
    found = found_within(wrong, 0, gaps)
    assert not gaps
    assert dict(outcome_rows(found))["refinements by training"] == "0"


def test_updates_are_given_up_as_soon_as_those_done_show_that_all_take_too_long():
    deadline = Deadline(0.5)
    on_chunk = deadline.watching(5000)
    time.sleep(0.1)
    on_chunk(250)  # compiled, too: this says nothing of the others
    time.sleep(0.1)
    with pytest.raises(OutOfTimeError) as late:
        on_chunk(500)
    assert late.value.seconds == pytest.approx(0.2 + 18 * 0.1, rel=0.3)


def test_the_packages_own_search_refines_unless_told_otherwise(
    wrong: Emulator, monkeypatch: pytest.MonkeyPatch
):
    asked = []

    def noted(refinement: Refinement, search: Search, attempt: Attempt) -> Attempt:
        asked.append(search.options.descent.iterations)
        return attempt

    monkeypatch.setattr(Refinement, "__call__", noted)
    system = load_system("pendulum")
    descent = DescentOptions(iterations=2)
    for options in (descent, SearchOptions(descent)):
        synthesise(wrong, system, stand_upright(), np.zeros(6), steps=5, options=options)
    alone(wrong, system, stand_upright(), np.zeros(6), steps=5, options=SearchOptions(descent))
    assert asked == [2, 2]


def test_minutes_below_none_are_refused(wrong: Emulator):
    with pytest.raises(NeuroAnimatorError, match="minutes: wanted 0 or more, got -1"):
        found_within(wrong, -1, [])


def test_control_says_before_it_learns_for_how_long_it_may(capsys: pytest.CaptureFixture[str]):
    _say_gap(0.5, 1.25)
    told = capsys.readouterr().err
    assert told.startswith("gap 1.25: training on the physics around the motion, at most 30 s in")
