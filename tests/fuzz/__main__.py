"""Fuzz every parser, one after the other, each in a process of its own.

python -m fuzz --seconds 600 [--parser toml]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from fuzz.seeds import CORPUS

PARSERS = sorted(folder.name for folder in CORPUS.iterdir())

ROOT = Path(__file__).parents[2]

LEAST_SECONDS = 1


def fuzz(parser: str, seconds: int, crashes: Path) -> bool:
    """Return whether `parser` got through `seconds` [s] without a crash; says how many inputs it had."""
    with tempfile.TemporaryDirectory() as found:
        command = [sys.executable, "-m", "fuzz.one", parser, str(seconds), str(crashes), found]
        result = subprocess.run(command, cwd=ROOT / "tests", capture_output=True, text=True, errors="replace")
        count = len(list(Path(found).iterdir()))
    lines = (result.stdout + result.stderr).splitlines()
    runs = next((line.split()[-1] for line in lines if "number_of_executed_units" in line), "some")
    print(f"{parser:12} {runs:>9} inputs, {count} of them took a new way", flush=True)
    if result.returncode:
        print("\n".join(lines[-40:]), flush=True)
    return result.returncode == 0


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=int, default=600, help="of fuzzing, all parsers together")
    options.add_argument("--parser", choices=PARSERS, help="this one alone")
    options.add_argument("--crashes", type=Path, default=ROOT / "out" / "crashes", help="where their inputs go")
    given = options.parse_args()
    parsers = [given.parser] if given.parser else PARSERS
    given.crashes.mkdir(parents=True, exist_ok=True)
    each = max(LEAST_SECONDS, given.seconds // len(parsers))
    crashed = [parser for parser in parsers if not fuzz(parser, each, given.crashes)]
    if crashed:
        sys.exit(f"Crashed: {', '.join(crashed)}. The inputs are in {given.crashes}.")


if __name__ == "__main__":
    main()
