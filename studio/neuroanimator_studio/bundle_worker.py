"""Make a bundle in a process of its own: `python -m neuroanimator_studio.bundle_worker FILE FOLDER ID`.

Each line on stdout says what is going on, or what was wrong.
"""

from __future__ import annotations

import sys
from pathlib import Path

PHASE = "phase"
"""How a line begins that says what is going on."""

FAULT = "fault"
"""How a line begins that says what was wrong."""


def main(source: str, folder: str, bundle_id: str) -> int:
    """Make the bundle; return the exit code."""
    from neuroanimator import NeuroAnimatorError
    from neuroanimator_studio.bundle import make_bundle
    from neuroanimator_studio.catalogue import BUNDLE, shipped_bundles

    def say(words: str) -> None:
        print(PHASE, words, flush=True)

    kept = [path.parent for path in Path(folder).parent.glob(f"*/{BUNDLE}")]
    try:
        make_bundle(source, Path(folder), bundle_id, say, known=[*shipped_bundles(), *kept])
    except NeuroAnimatorError as error:
        print(FAULT, " ".join(str(error).split()), flush=True)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
