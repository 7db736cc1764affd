"""Fuzz every parser, one after the other, each in a process of its own.

python -m fuzz --seconds 600 [--parser toml] [--keep]
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

from fuzz.corpus import PARSERS, read_corpus, write_corpus
from fuzz.one import FOUND

ROOT = Path(__file__).parents[2]

MIN_SECONDS = 1


MAX_KEPT = 12_000
"""[bytes] Of new inputs kept for one parser, the shortest first."""


def keep(parser: str, found: Path) -> None:
    """Add the inputs that took a new way to the parser's corpus, as far as there is room."""
    inputs = read_corpus(parser)
    room = MAX_KEPT
    for name, content in inputs.items():
        if name.startswith("found-"):
            room -= len(content)
    for path in sorted(found.iterdir(), key=lambda path: path.stat().st_size):
        content = path.read_bytes()
        room -= len(content)
        if room < 0:
            break
        inputs[f"found-{hashlib.sha256(content).hexdigest()[:16]}"] = content
    write_corpus(parser, inputs)


def fuzz(parser: str, seconds: int, crashes: Path, *, is_kept: bool) -> bool:
    """Return whether `parser` got through `seconds` [s] without a crash; says how many inputs it had."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "fuzz.one", parser, str(seconds), str(crashes), folder]
        result = subprocess.run(
            command, cwd=ROOT / "tests", capture_output=True, text=True, errors="replace"
        )
        found = Path(folder) / FOUND
        found.mkdir(exist_ok=True)
        count = len(list(found.iterdir()))
        if is_kept:
            keep(parser, found)
    lines = (result.stdout + result.stderr).splitlines()
    runs = next((line.split()[-1] for line in lines if "number_of_executed_units" in line), "some")
    print(f"{parser:12} {runs:>9} inputs, {count} of them took a new way", flush=True)
    if result.returncode:
        print("\n".join(lines[-40:]), flush=True)
    return result.returncode == 0


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument(
        "--seconds", type=int, default=600, help="of fuzzing, all parsers together"
    )
    options.add_argument("--parser", choices=PARSERS, help="this one alone")
    options.add_argument(
        "--crashes", type=Path, default=ROOT / "out" / "crashes", help="where their inputs go"
    )
    options.add_argument(
        "--keep", action="store_true", help="add what took a new way to the corpus"
    )
    given = options.parse_args()
    parsers = [given.parser] if given.parser else PARSERS
    given.crashes.mkdir(parents=True, exist_ok=True)
    each = max(MIN_SECONDS, given.seconds // len(parsers))
    crashed = [
        parser for parser in parsers if not fuzz(parser, each, given.crashes, is_kept=given.keep)
    ]
    if crashed:
        sys.exit(f"Crashed: {', '.join(crashed)}. The inputs are in {given.crashes}.")


if __name__ == "__main__":
    main()
