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
        sys.argv[2], num_envs=2, vectorization_mode="async", vector_kwargs={"context": context}
    )
    print(envs.reset(seed=0)[0].shape)
    envs.close()
"""


@pytest.mark.parametrize("name", ["pendulum", "pendulum-swing-up"])
@pytest.mark.parametrize(("context", "said"), [("fork", "in which JAX runs"), ("spawn", "(2, ")])
def test_forked_workers_are_refused_and_spawned_ones_work(
    context: str, said: str, name: str, tmp_path: Path
):
    """They hung for ever: JAX's threads are not there after a fork."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    run = subprocess.run(
        [sys.executable, program, context, f"neuroanimator/{name}-v0"],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert said in run.stdout + run.stderr
    assert (run.returncode == 0) == (context == "spawn")
