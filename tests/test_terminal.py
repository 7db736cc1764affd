"""What goes on is said on a terminal, and in lines on a pipe; how long it took is counted once."""

from __future__ import annotations

import os
import pty
import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

import pytest

from neuroanimator import terminal
from neuroanimator.terminal import inner_bar, phase, phase_seconds, progress_bar, show_phases

LONG = 0.4
"""Duration of what is long enough to be shown [s]."""


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is shown yet, and what is shown comes sooner than for people."""
    monkeypatch.setattr(terminal, "_screen", terminal._Screen())
    monkeypatch.setattr(terminal, "SHOWN_AFTER", LONG / 4)
    monkeypatch.setattr(terminal, "QUIET_FOR", LONG / 5)
    monkeypatch.setattr(terminal, "LINE_EVERY", LONG / 5)


@contextmanager
def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Let stderr be a terminal; yield a list that holds what it showed, afterwards."""
    ours, theirs = pty.openpty()
    parts = []
    shown = []

    def read() -> None:
        while True:
            try:
                part = os.read(ours, 4096)
            except OSError:  # the other end is closed
                return
            parts.append(part)

    reader = Thread(target=read)
    with monkeypatch.context() as changed, os.fdopen(theirs, "w") as stream:
        changed.setenv("TERM", "xterm")
        changed.setenv("COLUMNS", "100")
        changed.setattr(sys, "stderr", stream)
        reader.start()
        yield shown
    reader.join()
    os.close(ours)
    shown.append(b"".join(parts).decode())


def work() -> None:
    """Go through phases and bars, long and short ones."""
    with phase("settling"):
        time.sleep(LONG)
        with progress_bar("rounds", 2) as bar, phase("compiling"):
            time.sleep(LONG)
            bar.advance_to(2)
    with inner_bar("runs", 3) as bar:
        bar.advance_to(1)
        time.sleep(LONG)
    with phase("fleeting"), inner_bar("passing", 3):
        pass


def test_a_terminal_shows_phases_and_bars_side_by_side(monkeypatch: pytest.MonkeyPatch):
    with on_terminal(monkeypatch) as texts:
        show_phases()
        work()
    (shown,) = texts
    assert "settling" in shown
    assert "compiling" in shown
    assert "rounds" in shown
    assert "runs" in shown
    assert "1/3" in shown
    assert "fleeting" not in shown
    assert "passing" not in shown


def test_a_pipe_is_told_now_and_then_how_far_it_is(capsys: pytest.CaptureFixture[str]):
    show_phases()
    with phase("settling"):
        time.sleep(LONG)
        with progress_bar("rounds", 2) as bar:
            bar.advance_to(1, "J 3")
            time.sleep(LONG)
            with phase("compiling"):
                time.sleep(LONG)
    lines = capsys.readouterr().err
    assert re.search(r"settling ... \d s", lines)
    assert re.search(r"compiling ... \d s", lines)
    assert re.search(r"rounds: 1 of 2 after \d s, about \d s left \(J 3\)", lines)


def test_a_pipe_is_told_early_and_then_seldom(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(terminal, "QUIET_FOR", LONG)
    monkeypatch.setattr(terminal, "LINE_EVERY", 10.0)
    show_phases()
    with phase("settling"):
        time.sleep(3 * LONG)
    assert capsys.readouterr().err == "settling ... 0 s\n"


def test_short_work_after_short_work_is_told_on_a_pipe_too(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(terminal, "QUIET_FOR", 2 * LONG)
    show_phases()
    for name in ("loading", "settling", "drawing"):
        with phase(name):
            time.sleep(0.9 * LONG)
    assert capsys.readouterr().err.startswith("drawing ... 0 s\n")


def test_nothing_is_shown_of_what_is_quick_or_has_no_command_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    show_phases()
    monkeypatch.setattr(terminal, "QUIET_FOR", 10.0)
    work()
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(terminal, "_screen", terminal._Screen())
    with on_terminal(monkeypatch) as texts, phase("settling"):
        time.sleep(LONG)
        with inner_bar("runs", 3):
            time.sleep(LONG)
    assert texts == [""]


def test_time_within_an_inner_phase_counts_for_it_alone():
    began = time.monotonic()
    with phase("outer"):
        time.sleep(0.05)
        with phase("inner"):
            time.sleep(0.2)
    total = time.monotonic() - began
    spent = phase_seconds()
    assert spent["inner"] >= 0.2
    assert 0.05 <= spent["outer"] <= total - spent["inner"]


def test_what_another_thread_does_meanwhile_is_no_phase():
    def work() -> None:
        with phase("beside"):
            time.sleep(0.05)

    with phase("waiting"):
        thread = Thread(target=work)
        thread.start()
        thread.join()
    spent = phase_seconds()
    assert spent["waiting"] >= 0.05
    assert "beside" not in spent


def test_a_phase_that_fails_is_over():
    try:
        with phase("failing"):
            raise ValueError
    except ValueError:
        pass
    with phase("after"):
        time.sleep(0.1)
    assert phase_seconds()["failing"] < 0.1
