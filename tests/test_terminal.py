"""What goes on is said on a terminal, and in lines on a pipe; how long it took is counted once."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import time
from threading import Thread

from neuroanimator.terminal import phase, phase_seconds

PHASES = """
import time
from neuroanimator import terminal
terminal.show_phases()
with terminal.phase("settling"):
    time.sleep(0.8)
    with terminal.progress_bar("rounds", 2) as bar, terminal.phase("compiling"):
        time.sleep(0.8)
        bar.advance_to(2)
with terminal.inner_bar("runs", 3) as bar:
    bar.advance_to(1)
    time.sleep(0.5)
with terminal.phase("fleeting"), terminal.inner_bar("passing", 3):
    pass
print("done")
"""


def on_terminal(code: str) -> str:
    """Return what a process writes to its stderr if that is a terminal."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    process = subprocess.Popen(
        [sys.executable, "-c", code], stderr=theirs, stdout=subprocess.PIPE, env=environment
    )
    os.close(theirs)
    shown = b""
    while True:
        try:
            part = os.read(ours, 4096)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        shown += part
    os.close(ours)
    assert process.communicate()[0] == b"done\n"
    return shown.decode()


def test_a_terminal_shows_phases_and_bars_side_by_side():
    shown = on_terminal(PHASES)
    assert "settling" in shown
    assert "compiling" in shown
    assert "rounds" in shown
    assert "runs" in shown
    assert "1/3" in shown
    assert "fleeting" not in shown
    assert "passing" not in shown


def piped(code: str) -> str:
    """Return what a process writes to its stderr if that is a pipe."""
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.stdout == "done\n"
    return process.stderr


def test_a_pipe_is_told_now_and_then_how_far_it_is():
    often = PHASES.replace("import terminal\n", "import terminal\nterminal.LINE_EVERY = 0.3\n")
    lines = piped(
        often.replace("bar.advance_to(2)", "bar.advance_to(1, 'J 3')\n        time.sleep(0.7)")
    )
    assert re.search(r"settling ... \d s", lines)
    assert re.search(r"compiling ... \d s", lines)
    bars = often.replace(', terminal.phase("compiling")', "").replace(
        "time.sleep(0.8)\n        bar.advance_to(2)",
        "bar.advance_to(1, 'J 3')\n        time.sleep(0.8)",
    )
    assert re.search(r"rounds: 1 of 2 after \d s, about \d s left \(J 3\)", piped(bars))


def test_nothing_is_shown_of_what_is_quick_or_has_no_command_line():
    assert piped(PHASES) == ""
    quiet = on_terminal(
        PHASES.replace("terminal.show_phases()", "")
        .replace('terminal.progress_bar("rounds", 2) as bar, ', "")
        .replace("bar.advance_to(2)", "")
    )
    assert quiet == ""


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
