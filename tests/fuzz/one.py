"""Fuzz one parser in this process: guided by coverage where atheris runs, by chance elsewhere.

python -m fuzz.one PARSER SECONDS CRASHES FOLDER    new inputs go to FOLDER/found
"""

from __future__ import annotations

import importlib.util
import random
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

from fuzz.corpus import read_corpus, unpack_corpus
from fuzz.mutate import changed_json

LONGEST = 4096
"""Bytes of an input: faults that need more are tested one by one, in `tests/attacks`."""

MAX_SECONDS = 2.0
"""[s] Of this process's own time for one input; twice what is promised, as instrumented code is slower."""

MAX_MEMORY = 200
"""[MiB] Beyond what the imports take; twice what is promised, as the fuzzer's own tables grow too."""

FOUND = "found"
"""Name of the folder of inputs that took a new way."""

PATIENCE = 100
"""[s] Of the clock for one input: ends what hangs for good, and nothing else, on a busy machine."""


def watched(name: str, try_parser: Callable[[str, bytes], str]) -> Callable[[bytes], None]:
    """Return the parser as the fuzzer calls it: slow is as bad as wrong."""

    def one_input(content: bytes) -> None:
        began = time.process_time()
        try_parser(name, content)
        spent = time.process_time() - began
        assert spent < MAX_SECONDS, f"took {spent:.1f} s"

    return one_input


def by_coverage(name: str, seconds: int, crashes: Path, folder: Path) -> None:
    """Fuzz with atheris in an empty `folder`; ends the process, with an exit code other than 0 after a crash."""
    import atheris

    with atheris.instrument_imports(include=["neuroanimator", "tomllib"]):
        from fuzz.targets import try_parser
    usual = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    options = [
        f"-max_total_time={seconds}",
        f"-max_len={LONGEST}",
        f"-timeout={PATIENCE}",
        f"-rss_limit_mb={usual + MAX_MEMORY}",
        f"-artifact_prefix={crashes}/{name}-",
        "-verbosity=0",
        "-print_final_stats=1",
    ]

    def mutated(content: bytes, longest: int, seed: int) -> bytes:
        odd = changed_json(content, seed) if seed % 2 else None
        return odd if odd is not None and len(odd) <= longest else atheris.Mutate(content, longest)

    corpus = folder / "corpus"
    corpus.mkdir()
    unpack_corpus(name, corpus)
    found = folder / FOUND
    found.mkdir()
    arguments = [sys.argv[0], *options, str(found), str(corpus)]
    atheris.Setup(arguments, watched(name, try_parser), custom_mutator=mutated)
    atheris.Fuzz()


def by_chance(name: str, seconds: float, crashes: Path) -> None:
    """Fuzz with random changes of the corpus; the input of a crash is written and its error raised."""
    from fuzz.targets import try_parser

    one_input = watched(name, try_parser)
    corpus = list(read_corpus(name).values())
    rng = random.Random(time.time_ns())
    ends = time.monotonic() + seconds
    while time.monotonic() < ends:
        content = changed(rng, corpus)
        try:
            one_input(content)
        except BaseException:
            (crashes / f"{name}-crash").write_bytes(content)
            raise


def changed(rng: random.Random, corpus: list[bytes]) -> bytes:
    """Return one of the corpus with a few bytes replaced, doubled, cut, or taken from another."""
    first_guess = rng.choice(corpus)
    odd = changed_json(first_guess, rng.getrandbits(32)) if rng.random() < 0.5 else None
    if odd is not None:
        return odd
    content = bytearray(first_guess)
    for _ in range(rng.randint(1, 4)):
        first = rng.randint(0, len(content))
        last = min(len(content), first + rng.randint(0, 8))
        other = rng.choice(corpus)
        start = rng.randint(0, len(other))
        piece = rng.choice(
            (b"", rng.randbytes(2), bytes(content[first:last]) * 2, other[start : start + 16])
        )
        content[first:last] = piece
    return bytes(content[:LONGEST])


def main() -> None:
    name, seconds, crashes = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    folder = Path(sys.argv[4])
    if importlib.util.find_spec("atheris"):
        by_coverage(name, seconds, crashes, folder)
    else:
        by_chance(name, seconds, crashes)


if __name__ == "__main__":
    main()
