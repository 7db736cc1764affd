"""What a parser takes of the machine: each input tried in a child of its own, forked after all imports.

python -m fuzz.measure    reads lines "PARSER FILE", writes one line of JSON for each
"""

from __future__ import annotations

import functools
import json
import os
import resource
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

CEILING = 1024 * 2**20
"""[bytes] What a child may add to its address space: more ends in MemoryError instead of a full machine."""

MAX_SECONDS = 1.0
"""[s] Of the process's own time, which a busy machine does not lengthen much, on a machine as `usual_seconds` tells."""

YARDSTICK = 200_000
"""Squares summed up to time the machine."""

YARDSTICK_SECONDS = 0.016
"""[s] Own time in which a machine of two virtual cores at 3 GHz sums them up with Python 3.11."""

MAX_MEGABYTES = 100

MAX_MESSAGE = 500
"""Characters: a line on a wide terminal, and a long path."""

QUICK = 0.25
"""[s] Own time from which an input is tried again: a busy machine lengthens even that, and never shortens it."""

TRIES = 3

PATIENCE = 600
"""[s] Of the clock, for one input, on a busy machine."""


class Refusal(NamedTuple):
    """How a parser answered."""

    error: str
    """Name of the class raised; empty if the input was read."""
    is_ours: bool
    """Whether it is a NeuroAnimatorError."""
    message: str
    seconds: float
    """Of the process's own time; if it took long, in seconds of the usual machine (`usual_seconds`)."""
    megabytes: float
    """By which the most memory in use grew."""


def refusals(inputs: dict[str, tuple[str, bytes]], folder: Path) -> dict[str, Refusal]:
    """Return how each of the `inputs`, (parser, content) by name, is answered."""
    answers = {}
    for number, (name, (parser, content)) in enumerate(inputs.items()):
        path = folder / f"input-{number}"
        path.write_bytes(content)
        tried = [_ask(parser, path)]
        while tried[-1].seconds > QUICK and len(tried) < TRIES:
            tried.append(_ask(parser, path))
        answers[name] = min(tried, key=lambda answer: answer.seconds)
    return answers


def _ask(parser: str, path: Path) -> Refusal:
    process = _parsing_process()
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{parser} {path}\n")
    process.stdin.flush()
    readable, _, _ = select.select([process.stdout], [], [], PATIENCE)
    assert readable, f"no answer from {parser} in {PATIENCE} s"
    return Refusal(**json.loads(process.stdout.readline()))


@functools.cache
def _parsing_process() -> subprocess.Popen[str]:
    """Return the process that all inputs of this one are tried in: its imports take seconds. It ends with its input."""
    return subprocess.Popen(
        [sys.executable, "-m", "fuzz.measure"],
        cwd=Path(__file__).parents[1],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def check_refusal(answer: Refusal, message: str) -> None:
    """Fail unless the input was refused in one line holding `message`, within the second and 100 MB promised."""
    assert answer.is_ours, answer
    assert message in answer.message
    assert "\n" not in answer.message
    assert len(answer.message) < MAX_MESSAGE
    assert answer.seconds < MAX_SECONDS
    assert answer.megabytes < MAX_MEGABYTES


def _answer(parser: str, content: bytes) -> Refusal:
    from fuzz.targets import TARGETS
    from neuroanimator.errors import NeuroAnimatorError

    before = resource.getrusage(resource.RUSAGE_SELF)
    began = time.process_time()
    error: BaseException | None = None
    try:
        TARGETS[parser](content)
    except BaseException as caught:
        error = caught
    spent = time.process_time() - began
    if spent > QUICK:
        spent = usual_seconds(spent)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before.ru_maxrss
    is_ours = isinstance(error, NeuroAnimatorError)
    name = "" if error is None else type(error).__name__
    return Refusal(name, is_ours, str(error or "")[:5000], spent, grown / 1024)


def usual_seconds(spent: float) -> float:
    """Return the seconds that work of `spent` seconds takes on the usual machine; of a faster machine, as they are.

    Some machines of the tests are four times slower than others, and what is promised is not that they are fast.
    """
    began = time.process_time()
    total = 0
    for number in range(YARDSTICK):
        total += number * number
    return spent * min(1, YARDSTICK_SECONDS / (time.process_time() - began))


def main() -> None:
    import fuzz.targets  # noqa: F401 (loaded before the fork, so that it counts for no input)

    for line in sys.stdin:
        parser, path = line.rstrip("\n").split(" ", 1)
        content = Path(path).read_bytes()
        child = os.fork()
        if not child:
            _limit()
            print(json.dumps(_answer(parser, content)._asdict()), flush=True)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        if status:
            failed = Refusal(f"exit status {status}", False, "", 0.0, 0.0)
            print(json.dumps(failed._asdict()), flush=True)


def _limit() -> None:
    pages = (
        int(Path("/proc/self/statm").read_text().split()[0])
        if Path("/proc/self/statm").exists()
        else 0
    )
    if pages:
        most = pages * resource.getpagesize() + CEILING
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    main()
