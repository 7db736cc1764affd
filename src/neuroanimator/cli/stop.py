"""Ctrl-C, SIGTERM and SIGHUP end the process at once, wherever it is, with one line that says so.

They raise no exception. It would have to pass through libraries that swallow it (JAX's callback at garbage
collection does), turn it into another one (modules during import do) or crash; and a long compiled call does not
check for it. Nothing is lost by ending without unwinding: every file is whole or absent, unfinished files are
removed here, and child processes are ended.

Only light modules are imported, so that the first moments of the imports can be stopped too.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from pathlib import Path
from types import FrameType
from typing import NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end the process: from Ctrl-C, from `kill`, and from a terminal that is closed."""

STDERR = 2
"""The file descriptor of stderr."""

SHOW_CURSOR = "\r\n\x1b[?25h"
"""Begins a line after the terminal's '^C', and shows the cursor, which the progress bar has hidden."""

PATIENCE = 0.5
"""Time after which another thread ends the process, if a compiled call does not return [s]."""

RESUMABLE = frozenset({"demo", "generate", "improve", "train"})
"""Verbs that keep what they have done and go on from there when started again."""


class Stop:
    """The signal handler; one per process."""

    def __init__(self) -> None:
        self._ending = threading.Lock()
        self._is_done = False

    def listen(self) -> None:
        """Take over the signals, except those that the parent process set to be ignored."""
        if threading.current_thread() is not threading.main_thread():
            return
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        threading.Thread(target=self._guard, args=(reader,), name="stop", daemon=True).start()
        # The system itself writes to it, even while the main thread is in a compiled call.
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        for number in SIGNALS:
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._on_signal)

    def ignore(self) -> None:
        """Ignore the signals from now on: the work is done, and the process is about to exit."""
        self._is_done = True

    def end(self, number: int) -> NoReturn:
        """End the process and its children, with one line and the exit code of the signal `number`."""
        if not self._ending.acquire(blocking=False):
            time.sleep(60)  # the other thread ends the process meanwhile
        for tidy in (_end_children, _remove_leftovers, _show_what_was_printed, _say_so):
            with contextlib.suppress(Exception):
                tidy()
        os._exit(128 + number)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if not self._is_done:
            self.end(number)

    def _guard(self, reader: int) -> None:
        number = 0
        while number not in SIGNALS:
            number = os.read(reader, 1)[0]
        time.sleep(PATIENCE)
        self._on_signal(number, None)


def _end_children() -> None:
    """Kill all descendants of this process, such as a compiler, a film's renderer, or a cluster on this machine.

    Without /proc this is left to the terminal.
    """
    own = os.getpid()
    for child in _descendants(own):
        with contextlib.suppress(OSError):  # gone meanwhile
            is_leader = os.getpgid(child) == child
            if is_leader:
                os.killpg(child, signal.SIGKILL)
            else:
                os.kill(child, signal.SIGKILL)


def _descendants(process: int) -> list[int]:
    """Return the descendants of a process, parents before children, since they could start others."""
    found = []
    for children in Path(f"/proc/{process}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # gone meanwhile
            for word in children.read_text().split():
                child = int(word)
                found += [child, *_descendants(child)]
    return found


def _remove_leftovers() -> None:
    # Not imported here: if nothing else has imported it, there is nothing to remove.
    module = sys.modules.get("neuroanimator.files.unfinished")
    remove = getattr(module, "remove_leftovers", None)
    if remove is not None:
        remove()


def _show_what_was_printed() -> None:
    sys.stdout.flush()


def _say_so() -> None:
    verb = next((word for word in sys.argv[1:] if not word.startswith("-")), "")
    line = "No file was left half-written."
    if verb in RESUMABLE or "--sweep" in sys.argv:
        line = "Run the command again: it resumes where it stopped."
    before = ""
    if os.isatty(STDERR):
        before = SHOW_CURSOR
    os.write(STDERR, f"{before}neuroanimator: Stopped. {line}\n".encode())


STOP = Stop()
"""The only signal handler of the process."""
