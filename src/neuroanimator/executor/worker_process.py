"""A worker process of this machine.

python -m neuroanimator.executor.worker_process DESCRIPTOR      computes the calls that arrive on that socket
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import time
from multiprocessing.connection import Connection

from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.executor.worker import Answer, perform
from neuroanimator.text import printable

WATCH_PERIOD = 0.5
"""Interval between a worker's checks that its parent process is alive [s]."""


def main() -> None:
    """Compute the calls that arrive, one after the other, until the other end is closed."""
    # Ctrl-C in a terminal reaches every process of the job: the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    connection = Connection(int(sys.argv[1]))
    try:
        while True:
            answer = perform(connection.recv_bytes())
            connection.send_bytes(packed(answer))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


def packed(answer: Answer) -> bytes:
    """Return an answer as bytes; one that cannot be sent becomes an error that says so."""
    try:
        return pickle.dumps(answer, pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        line = " ".join(f"its result cannot be sent: {error}".split())
        return pickle.dumps(Answer(None, NeuroAnimatorError(printable(line)), ""))


def _end_with(parent: int) -> None:
    """End this process at once when its parent is gone."""
    while os.getppid() == parent:
        time.sleep(WATCH_PERIOD)
    os._exit(1)


if __name__ == "__main__":
    main()
