"""How long a user waits for a first controller: a process of its own, from its start to its end.

`python -m benchmarks.control.first_controller TASK` finds the controller of a task's first trial, and says nothing.
"""

from __future__ import annotations

import subprocess
import sys
import time

from neuroanimator.errors import NeuroAnimatorError

MEASURED_TRIAL = 0
"""The number of the trial that is solved."""

TRIES = 3
"""Number of processes of which the quickest counts: the machine has other things to do, too."""

LIMIT = 300.0
"""[s] A process that takes longer is given up."""


def cold_seconds(task: str) -> float:
    """Return how long a fresh process takes to find the first controller of `task` [s], imports and all.

    What is compiled once a machine must be there already.
    """
    return min(_seconds_of_process(task) for _ in range(TRIES))


def _seconds_of_process(task: str) -> float:
    began = time.perf_counter()
    command = [sys.executable, "-m", "benchmarks.control.first_controller", task]
    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT)
    if process.returncode:
        raise NeuroAnimatorError(f"A process for {task} failed:\n{process.stderr}")
    return time.perf_counter() - began


def main() -> None:
    """Solve the first trial of the task that the command line names."""
    # Not at the top, and not what the table needs besides: plots and baselines would be waited for, too.
    from benchmarks.control.solve_trial import solve_trial
    from neuroanimator.learn.tasks.all_tasks import TASKS
    from neuroanimator.learn.tasks.solver import Solver

    solver = Solver.shipped(TASKS[sys.argv[1]])
    solve_trial(solver, solver.draw(MEASURED_TRIAL))


if __name__ == "__main__":
    main()
