"""Do the training planned in a folder: `python -m neuroanimator_studio.job_worker FOLDER BUNDLES`.

It runs on without the page and without the server. Stopped at any moment, and started again, it goes on where it was.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from pathlib import Path

from neuroanimator import NeuroAnimatorError
from neuroanimator.authoring import canonical_json, locked, write_whole

STATUS = "status.json"
"""The file of a job's folder that says how far it is."""

RUN = "job.emulator.run"
"""The folder of its training, as `learn.training.train.run_folder` calls it."""

DATA = "data"
"""The folder of a job with what it learns from; it goes when the training is done."""

OUT = "job.emulator.safetensors"
"""The file of a job's emulator."""

NICENESS = 5
"""How much the process leaves to others: the page's pictures come first."""

SECONDS_BETWEEN = 0.25
"""Time between two reports of the same phase [s]."""


class Reporter:
    """Says in a file how far the job is."""

    def __init__(self, folder: Path):
        self._path = folder / STATUS
        self._last = 0.0
        self._phase = ""

    def say(self, phase: str, done: int = 0, total: int = 0, **more: object) -> None:
        """Write the phase and how much of it is done, not too often."""
        now = time.monotonic()
        if phase == self._phase and done < total and now - self._last < SECONDS_BETWEEN:
            return
        self._last = now
        self._phase = phase
        status = {"phase": phase, "done": done, "of": total, **more}
        write_whole(self._path, canonical_json(status).encode())


def main(folder: Path, bundles: Path) -> int:
    """Do the job; return the exit code."""
    os.nice(NICENESS)
    reporter = Reporter(folder)
    try:
        with locked(folder):
            _train(folder, bundles, reporter)
    except NeuroAnimatorError as error:
        reporter.say("failed", words=" ".join(str(error).split()))
        return error.exit_code
    except MemoryError:
        reporter.say("failed", words="Out of memory. Choose a smaller size.")
        return 4
    except Exception as error:
        reporter.say("failed", words=f"Unexpected {type(error).__name__}. The job's log says more.")
        raise
    return 0


def _train(folder: Path, bundles: Path, reporter: Reporter) -> None:
    """Simulate, train, and put the emulator on show."""
    reporter.say("starting")
    # What takes a second to import comes when somebody can see that it is coming.
    from neuroanimator import generate, read_transitions, train
    from neuroanimator_studio.job_plan import read_plan
    from neuroanimator_studio.job_settings import data_of, training_of
    from neuroanimator_studio.library import Library

    plan = read_plan(folder)
    config = data_of(plan, folder)
    done = 0

    def on_shard() -> None:
        nonlocal done
        done += 1
        reporter.say("data", done, config.shards)

    reporter.say("data", 0, config.shards)
    generate(config, folder / DATA, on_shard=on_shard)
    transitions = read_transitions(folder / DATA)
    settings = training_of(plan, folder, transitions.system)
    total = settings.whole_updates
    reporter.say("training", 0, total)
    train(
        transitions,
        settings,
        folder / OUT,
        on_report=lambda report: reporter.say(
            "training", report.update, total, loss=report.loss, error=report.error
        ),
    )
    reporter.say("bundle")
    bundle_id = Library(bundles).add(folder / OUT)
    shutil.rmtree(folder / DATA, ignore_errors=True)
    reporter.say("done", total, total, bundle=bundle_id)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
