"""The command line: `neuroanimator VERB`."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from neuroanimator.cli import animate, bench, control, demo, doctor, evaluate, export, generate, info, new, train
from neuroanimator.cli import list as list_
from neuroanimator.cli.usage import Verbs
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.text import open_streams, print_line

app = typer.Typer(
    cls=Verbs,
    name="neuroanimator",
    help="Learn a physics model once, then animate and control it at a fraction of the cost.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
VERBS = {
    "demo": demo, "doctor": doctor, "list": list_, "new": new, "generate": generate, "train": train,
    "evaluate": evaluate, "animate": animate, "control": control, "export": export, "bench": bench,
    "info": info,
}  # fmt: skip
for verb, module in VERBS.items():
    app.command(verb, epilog=f"Example: {module.EXAMPLE}")(module.run)


def print_version(is_wanted: bool) -> None:
    """Print the installed version and end, if that is wanted."""
    if not is_wanted:
        return
    from importlib.metadata import version

    print(f"neuroanimator {version('neuroanimator')}")
    raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Learn a physics model once, then animate and control it at a fraction of the cost."""


def main() -> None:
    """Run the command line; end with the exit code the error asks for and never with a traceback."""
    open_streams()
    try:
        _run()
    finally:
        say_what_mujoco_warned_of()


def say_what_mujoco_warned_of() -> None:
    """Print one line on stderr if MuJoCo warned of anything; import nothing that was not needed so far."""
    counted = sys.modules.get("neuroanimator.systems.mujoco_warnings")
    if counted is not None and (line := counted.warning_line()):
        print(f"neuroanimator: {line}", file=sys.stderr)


def _run() -> None:
    try:
        app()
    except NeuroAnimatorError as error:
        fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        fail("Interrupted. Nothing is lost: the same command goes on where it stopped.", 130)
    except MemoryError:
        fail("Out of memory. Ask for less at once.", 4)
    except OSError as error:
        fail(f"{error.strerror or error}: {error.filename or ''}", 4)
    except Exception as error:
        if os.environ.get("NEUROANIMATOR_DEBUG"):
            raise
        fail(
            f"Unexpected {type(error).__name__}: {error}. NEUROANIMATOR_DEBUG=1 shows where; please report it.",
            1,
        )


def fail(message: str, code: int) -> None:
    """Print one line on stderr and end with `code`."""
    print_line(f"neuroanimator: {' '.join(message.split())}", to_stderr=True)
    sys.exit(code)
