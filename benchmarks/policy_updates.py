"""Learning speed of a policy that walks on command: transitions per second by the number of bodies side by side.

python benchmarks/policy_updates.py --bodies 128 1024
JAX_PLATFORMS=cpu python benchmarks/policy_updates.py --bodies 1024 --dry

Updates of `neuroanimator policy examples/human/commanded.toml` are timed by the wall clock, after one that compiles. MuJoCo moves
the bodies on all cores; networks are JAX's, on a GPU if it finds one. The rollout is MuJoCo, the policy and the task.

Writes results/policy_updates.csv, by default.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from neuroanimator.control.policies.state_policy import load_state_policy
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.executor.cores import core_count
from neuroanimator.gym.learner import Learner
from neuroanimator.gym.policy_task import task_to_learn
from neuroanimator.systems import load_system
from neuroanimator.systems.loading import resolve
from neuroanimator.terminal import print_table

HUMAN = Path(__file__).parents[1] / "examples" / "human"

RESULTS = Path(__file__).parent / "results"

TOML = HUMAN / "commanded.toml"

UPDATES = 5


def learner_of(bodies: int) -> Learner:
    """Return what learns to walk on command, beginning with the policy that ships."""
    _, definition, _ = resolve(str(TOML))
    system = load_system(str(TOML))
    task = task_to_learn(definition, TOML, system)
    start = load_state_policy(HUMAN / "human.policy.safetensors")
    learning = replace(task.learning, bodies=bodies)
    return Learner(system, start.emulator, task.rules, learning, task.motion, start)


def timed(bodies: int) -> dict[str, Any]:
    """Return how many transitions a second are learnt from."""
    learner = learner_of(bodies)
    # The policy is fitted from the first update on.
    learner.critic_first = 0
    learner.advance()
    totals = []
    rollouts = []
    for update in range(UPDATES):
        rng = np.random.default_rng(update)
        began = time.perf_counter()
        learner._roll_out(rng, learner.policy)
        rollouts.append(time.perf_counter() - began)
        began = time.perf_counter()
        learner.advance()
        totals.append(time.perf_counter() - began)
    count = bodies * learner.learning.horizon
    return {
        "device": jax.devices()[0].platform,
        "cores": core_count(),
        "bodies": bodies,
        "update s": float(np.median(totals)),
        "rollout s": float(np.median(rollouts)),
        "transitions a second": round(count / float(np.median(totals))),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--bodies", type=int, nargs="+", default=[128, 512, 1024])
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    print(describe_machine())
    rows = [timed(bodies) for bodies in arguments.bodies]
    print_table(rows)
    if not arguments.dry:
        write_csv(RESULTS / "policy_updates.csv", rows)


if __name__ == "__main__":
    main()
