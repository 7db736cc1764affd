"""Environments in processes of their own, as Gymnasium starts them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from waiting import PATIENCE

PROGRAM = """
import sys
import gymnasium
import neuroanimator.gym

if __name__ == "__main__":
    context = sys.argv[1]
    envs = gymnasium.make_vec(
        "neuroanimator/pendulum-v0",
        num_envs=1,
        vectorization_mode="async",
        vector_kwargs={"context": context},
    )
    print(envs.reset(seed=0)[0].shape)
    envs.close()
"""


@pytest.mark.parametrize(
    ("context", "said"),
    [
        ("fork", "in which JAX runs"),
        pytest.param("spawn", "(1, ", marks=pytest.mark.endurance),  # as any new process
    ],
)
def test_forked_workers_are_refused_and_spawned_ones_work(context: str, said: str, tmp_path: Path):
    """They hung for ever: JAX's threads are not there after a fork."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    run = subprocess.run(
        [sys.executable, program, context],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert said in run.stdout + run.stderr
    assert (run.returncode == 0) == (context == "spawn")
