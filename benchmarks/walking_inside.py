"""Returns of walking policies inside an emulator of their own motions, beside those in Gymnasium's environments.

python benchmarks/walking_inside.py                                 one policy of each body; keeps what it makes in ./walking
python benchmarks/walking_inside.py Hopper-v5 --folder walking --dry

Each run calls `neuroanimator new`, `policy`, `train` on the policy's file, and `evaluate`, all with their defaults but for the
number of updates of the policy. The emulator that learns along with a policy is for its gradients; `train` replaces it by one of
a million super steps of the policy's own motions. Returns are means of 100 episodes without noise. What the folder already holds
is not made again.

Writes results/walking_inside.csv.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from following import RESULTS
from walking import EPISODES, run

from neuroanimator.evaluation.csv_table import merge_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.terminal import print_table

UPDATES = {"Hopper-v5": 190, "Walker2d-v5": 300, "Ant-v5": 640}
"""Number of updates of each policy: those of walking.py come as far in its minutes."""

SEED = 100


def measured(env_id: str, folder: Path) -> dict[str, Any]:
    """Return the row of a body, whose policy and emulator are made in `folder` where it lacks them."""
    toml = f"{env_id}.toml"
    policy = f"{env_id}.policy.safetensors"
    inside = f"{env_id}.inside.policy.safetensors"
    if not (folder / toml).exists():
        run(folder, "new", env_id)
    if not (folder / policy).exists():
        learning = ("--updates", UPDATES[env_id], "--seed", SEED)
        run(folder, "policy", toml, *learning, "--out", policy)
    if not (folder / inside).exists():
        run(folder, "train", policy, "--out", inside)
    along = evaluated(folder, policy)
    own = evaluated(folder, inside)
    outside = own["mean_return"]
    return {
        "environment": env_id,
        "seed": SEED,
        "episodes": EPISODES,
        "mean_return": outside,
        "least_return": own["least_return"],
        "inside, learnt along": along["mean_return_inside"],
        "inside, of its motions": own["mean_return_inside"],
        "off": own["mean_return_inside"] / outside - 1,
        "one-step error": one_step_error(folder / f"{env_id}.inside.policy.run"),
    }


def evaluated(folder: Path, policy: str) -> dict[str, Any]:
    """Return what `evaluate` says of a policy's file."""
    return json.loads(run(folder, "evaluate", policy, "--episodes", EPISODES, "--json"))


def one_step_error(folder: Path) -> float:
    """Return the error of the emulator after a super step, over a usual change, on runs it was not trained on."""
    (metrics,) = folder.glob("*.emulator.run/metrics.jsonl")
    return min(json.loads(line)["error"] for line in metrics.read_text().splitlines())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("environments", nargs="*", default=list(UPDATES))
    parser.add_argument("--folder", type=Path, default=Path("walking"), help="of what is made")
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    print(describe_machine())
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for env_id in arguments.environments:
        row = measured(env_id, arguments.folder)
        print_table([row])
        if not arguments.dry:
            merge_csv(RESULTS / "walking_inside.csv", [row], "environment", "seed")


if __name__ == "__main__":
    main()
