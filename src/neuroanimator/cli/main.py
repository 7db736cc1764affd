"""The command line: `neuroanimator VERB`. Light to import, so that Ctrl-C works from the first moment."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

from neuroanimator.cli.stop import STDERR, STOP
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.text import open_streams, print_line

# XLA logs an error of a thousand characters for each kept program on some processors, though it uses them all
# (docs/decisions/0014-compiled-once-a-machine.md); what matters comes as a Python exception.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

STDOUT = 1
"""The file descriptor of stdout."""


def main() -> None:
    """Run the command line; end with the exit code of the error and never with a traceback."""
    STOP.listen()
    keep_results_apart()
    try:
        _run()
    finally:
        STOP.ignore()


def keep_results_apart() -> None:
    """Leave stdout to results: what C libraries print there, such as a simulator's banner, goes to stderr from now on."""
    if sys.stdout is None or sys.stderr is None:
        return
    results = os.fdopen(os.dup(STDOUT), "w", encoding=sys.stdout.encoding)
    if os.environ.get("PYTHONUNBUFFERED"):
        results.reconfigure(line_buffering=True)
    os.dup2(STDERR, STDOUT)
    sys.stdout = sys.__stdout__ = results


def _run() -> None:
    try:
        open_streams()
        from neuroanimator.cli.verbs import app

        try:
            app()
        except SystemExit:
            write_out()
            raise
        finally:
            say_what_mujoco_warned_of()
    except NeuroAnimatorError as error:
        fail(str(error), error.exit_code)
    except MemoryError:
        fail("Out of memory. Reduce the size of the job.", 4)
    except BrokenPipeError:
        # Whoever reads the results has read enough, as `head` does.
        with suppress(OSError):
            write_out()
        sys.exit(1)
    except OSError as error:
        name = ""
        if error.filename:
            name = f": {error.filename}"
        with suppress(OSError):
            write_out()
        fail(f"{error.strerror or error}{name}", 4)
    except Exception as error:
        if os.environ.get("NEUROANIMATOR_DEBUG"):
            raise
        fail(
            f"Unexpected {type(error).__name__}: {error}. NEUROANIMATOR_DEBUG=1 shows where; please report it.",
            1,
        )


def write_out() -> None:
    """Write what stdout still holds. If that fails it is forgotten, for Python would try again at its end."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise


def say_what_mujoco_warned_of() -> None:
    """Print one line on stderr if MuJoCo warned of anything; import nothing that has not been imported."""
    warnings_module = sys.modules.get("neuroanimator.physics.rigid.warnings")
    if warnings_module is None:
        return
    line = warnings_module.warning_line()
    if line:
        print_line(f"neuroanimator: {line}", to_stderr=True)


def fail(message: str, code: int) -> None:
    """Print one line on stderr and end with `code`."""
    print_line(f"neuroanimator: {' '.join(message.split())}", to_stderr=True)
    sys.exit(code)
