"""While `new` tries controls and super steps it says so at each, and what it only tried is not reported."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from neuroanimator.physics.rigid.warnings import warnings_heard
from neuroanimator.scaffold import model, motion, teacher

LINK = """<mujoco><option timestep="0.01"/><worldbody>
  <body><joint name="arm" axis="0 1 0" {more}/><geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/></body>
</worldbody><actuator><motor joint="arm" gear="{gear}" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize("gear", [0.1, 1.0, 3.0, 200.0])
def test_progress_is_told_at_each_try(gear: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "arm.xml"
    path.write_text(LINK.format(gear=gear, more=""))
    events: list[int | str] = []
    totals = []
    run_trial = motion.run_trial

    class Recorder:
        def advance_to(self, done: int, note: str = "") -> None:
            events.append(done)

    @contextmanager
    def recording(title: str, total: int) -> Iterator[Recorder]:
        totals.append(total)
        yield Recorder()

    def counted(*arguments):
        events.append("trial")
        return run_trial(*arguments)

    monkeypatch.setattr(motion, "progress_bar", recording)
    monkeypatch.setattr(motion, "run_trial", counted)
    monkeypatch.setattr(teacher, "MAX_TRIAL_SECONDS", 0.02)  # the teacher does not matter here
    model.propose(path)
    [total] = totals
    told = [event for event in events if isinstance(event, int)]
    assert told == sorted(told)
    assert 0 <= told[0] <= told[-1] <= total
    # A try is two trials: the bar never stands still for longer.
    waits = "".join("t" if event == "trial" else " " for event in events).split()
    assert waits
    assert max(map(len, waits)) <= 2
    assert len(set(told)) >= len(waits)


def test_warnings_of_what_was_only_tried_are_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "stiff.xml"
    # Euler's damping is implicit; Runge and Kutta's diverges.
    path.write_text(LINK.format(gear=1.0, more='damping="1e4"'))
    before = warnings_heard()
    tried = []
    forget = model.forget_other_than

    def noted(warnings):
        tried.append(warnings_heard() - before)
        forget(warnings)

    monkeypatch.setattr(model, "forget_other_than", noted)
    monkeypatch.setattr(teacher, "MAX_TRIAL_SECONDS", 0.02)
    model.propose(path)
    [heard] = tried
    assert heard.total() > 0
    assert warnings_heard() == before
