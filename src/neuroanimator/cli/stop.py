"""Ctrl-C and SIGTERM: the work unwinds, one line says so, and the process ends within seconds.

A signal raises `Stopped` in the main thread. Two things can keep that from ending the process, and both are seen by
a thread that does nothing else: a library's callback may swallow the exception (JAX's at garbage collection does),
so it is raised again; and one long compiled call may not come back, so after a while the process ends without
unwinding. Nothing is lost then: every file is whole or absent.

Only light modules are imported here, so that the first moments of the imports can be stopped too.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import NoReturn

SIGNALS = (signal.SIGINT, signal.SIGTERM)

PATIENCE = 4.0
"""[s] The work may take to unwind. A compiled call is not waited for longer."""

LOOK_EVERY = 0.05
"""[s] Between two looks whether the exception was swallowed."""

RESUMABLE = frozenset({"demo", "generate", "train"})
"""Verbs that keep what they have done and go on from there."""


class Stopped(BaseException):
    """The user wants an end. No KeyboardInterrupt: libraries, and typer, make something else of that."""


class Stop:
    """What has been heard of a wish to stop; one for the process."""

    def __init__(self) -> None:
        self.signal: int | None = None
        self._is_swallowed = False
        self._show_unraisable = sys.unraisablehook
        self._ending = threading.Lock()

    def listen(self) -> None:
        """Take over the signals, but for those that whoever started this process wants ignored."""
        if threading.current_thread() is not threading.main_thread():
            return
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        self._show_unraisable = sys.unraisablehook
        sys.unraisablehook = self._on_unraisable
        threading.Thread(target=self._guard, args=(reader,), name="stop", daemon=True).start()
        # Written to by the system itself, even while the main thread is deep in a compiled call.
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        for number in SIGNALS:
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._on_signal)

    def ignore(self) -> None:
        """Hear no signals any more: the work is done, or its end is under way."""
        if threading.current_thread() is threading.main_thread():
            for number in SIGNALS:
                signal.signal(number, signal.SIG_IGN)

    def end(self) -> NoReturn:
        """End the process with one line and the exit code of the signal."""
        if not self._ending.acquire(blocking=False):
            time.sleep(PATIENCE)  # the other thread ends the process meanwhile
        with contextlib.suppress(Exception):
            _remove_leftovers()
            _say(_line())
            sys.stdout.flush()
        # Not sys.exit: what libraries do at an exit may hang, and has nothing left to save.
        os._exit(128 + (self.signal or signal.SIGINT))

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        # While the work unwinds it is left alone: a second Ctrl-C would only keep it from tidying up.
        if self.signal is None or self._is_swallowed:
            self.signal, self._is_swallowed = number, False
            raise Stopped

    def _on_unraisable(self, event: sys.UnraisableHookArgs) -> None:
        if self.signal is not None and issubclass(event.exc_type, Stopped):
            self._is_swallowed = True
        else:
            self._show_unraisable(event)

    def _guard(self, reader: int) -> None:
        number = 0
        while number not in SIGNALS:
            number = os.read(reader, 1)[0]
        last_moment = time.monotonic() + PATIENCE
        while time.monotonic() < last_moment:
            time.sleep(LOOK_EVERY)
            if self._is_swallowed:
                signal.pthread_kill(threading.main_thread().ident or 0, number)
        self.signal = self.signal or number
        self.end()


def _line() -> str:
    verb = next((word for word in sys.argv[1:] if not word.startswith("-")), "")
    if verb in RESUMABLE or "--sweep" in sys.argv:
        return "Stopped. Started again, it goes on where it stopped."
    return "Stopped. No file was left half-written."


def _say(line: str) -> None:
    # A terminal has shown '^C', and the bar has hidden the cursor.
    before = "\r\n\x1b[?25h" if sys.stderr.isatty() else ""
    sys.stderr.write(f"{before}neuroanimator: {line}\n")
    sys.stderr.flush()


def _remove_leftovers() -> None:
    # Not imported for its own sake: if nobody has, there is nothing to remove.
    module = sys.modules.get("neuroanimator.unfinished")
    remove = getattr(module, "remove_leftovers", None)
    if remove is not None:
        remove()


STOP = Stop()
"""The process has one."""
