"""Returns of walking policies inside an emulator of their own motions, beside those in Gymnasium's environments.

python -m benchmarks.walking.walking_inside  one policy of each body; keeps what it makes in ./walking
python -m benchmarks.walking.walking_inside Hopper-v5 --folder walking --dry

Each run calls `neuroanimator new`, `policy`, `train` on the policy's file, and `evaluate`, all with their defaults but for the
number of updates of the policy. The emulator that learns along with a policy is for its gradients; `train` replaces it by one of
a million super steps of the policy's own motions. Returns are means of 100 episodes without noise. What the folder already holds
is not made again.

The physics is off, too: returns on MuJoCo are also measured at a tenth of the model's physics step, by the policy's rules, which
leave out an ant's cost of contact, beside those at its own step.

An emulator's errors are noise to a body on its edge: the returns of 50 episodes in it are also measured with errors added to each
super step, drawn at random from those of 64 bodies that the policy moves on MuJoCo, half of them and all.

Writes walking_inside.csv.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from benchmarks.following.commanded import controls_of
from benchmarks.harness import keep_rows, parser_of, show_rows
from benchmarks.walking.walking import EPISODES, run
from neuroanimator.cli.policy_returns import loaded_policy
from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.gym.bodies import Bodies, episodes_of
from neuroanimator.gym.policy_task import PolicyTask
from neuroanimator.gym.state_rows import EmulatorStepper, Leap, physics_stepper
from neuroanimator.systems.system import System

UPDATES = {"Hopper-v5": 190, "Walker2d-v5": 300, "Ant-v5": 640}
"""Number of updates of each policy: about as many as a run of walking.py makes in its time."""

SEED = 100

FINE = 10
"""Number of fine physics steps in one of the model's own."""

SHARES = (0.5, 1.0)
"""Parts of the errors that are added."""

NOISY_EPISODES = 50

BODIES = 64
"""Number of bodies whose errors are measured."""

SETTLING = 30
"""Number of super steps before errors are measured."""

SUPER_STEPS = 300


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
    loaded = loaded_policy(folder / inside, None)
    told = run(folder, "evaluate", inside, "--episodes", EPISODES, "--json")
    found = json.loads(told)
    return {
        "environment": env_id,
        "seed": SEED,
        "episodes": EPISODES,
        "mean_return": found["mean_return"],
        "least_return": found["least_return"],
        "own physics step": return_on_physics(*loaded, 1),
        "fine physics step": return_on_physics(*loaded, FINE),
        "inside, learnt along": return_inside(folder / policy),
        "inside, of its motions": found["mean_return_inside"],
        "off": found["mean_return_inside"] / found["mean_return"] - 1,
        "one-step error": one_step_error(folder / f"{env_id}.inside.policy.run"),
        **with_errors(*loaded),
    }


def return_on_physics(policy: StatePolicy, system: System, task: PolicyTask, parts: int) -> float:
    """Return the policy's mean return on MuJoCo, by its rules, with `parts` steps in each of the model's own."""
    scheme = replace(system.scheme, dt=system.scheme.dt / parts)
    outside = physics_stepper(system, scheme, policy.dt)
    return float(episodes_of(policy, outside, task.rules, EPISODES, SEED).returns.mean())


def return_inside(path: Path) -> float:
    """Return the mean return in the emulator of the policy at `path`, as `evaluate` does."""
    policy, _, task = loaded_policy(path, None)
    inside = EmulatorStepper(policy.emulator, np.inf, 0.0)
    return float(episodes_of(policy, inside, task.rules, EPISODES, 0).returns.mean())


def one_step_error(folder: Path) -> float:
    """Return the error of the emulator after a super step, over a usual change, on runs it was not trained on."""
    (metrics,) = folder.glob("*.emulator.run/metrics.jsonl")
    return min(json.loads(line)["error"] for line in metrics.read_text().splitlines())


def with_errors(policy: StatePolicy, system: System, task: PolicyTask) -> dict[str, float]:
    """Return the mean return in the policy's emulator, a share of its errors added to each super step."""
    errors = errors_of(policy, system, task)
    plain = EmulatorStepper(policy.emulator, np.inf, 0.0)
    rng = np.random.default_rng(SEED)
    returns = {}
    for share in SHARES:

        def noisy(
            states: Float[np.ndarray, "B S"],
            controls: Float[np.ndarray, "B C"],
            is_new: Bool[np.ndarray, " B"],
            share: float = share,
        ) -> Leap:
            leap = plain(states, controls, np.ones_like(is_new))
            drawn = rng.integers(len(errors), size=len(states))
            return leap._replace(states=leap.states + share * errors[drawn])

        found = episodes_of(policy, noisy, task.rules, NOISY_EPISODES, SEED).returns
        returns[f"inside, {share:g} of its errors added"] = float(found.mean())
    return returns


def errors_of(policy: StatePolicy, system: System, task: PolicyTask) -> Float[np.ndarray, "E S"]:
    """Return the errors of the emulator after a super step, in states that the policy visits on MuJoCo."""
    rng = np.random.default_rng(SEED)
    bodies = Bodies(
        physics_stepper(system, system.scheme, policy.dt), task.rules, policy.emulator, rng, BODIES
    )
    inside = EmulatorStepper(policy.emulator, np.inf, 0.0)
    errors = []
    for step in range(SUPER_STEPS):
        states = bodies.states.copy()
        controls = controls_of(policy, states)
        leap = inside(states, controls, np.ones(BODIES, bool))
        moved = bodies.step(controls)
        if step >= SETTLING:
            errors.append(leap.states - bodies.states)
        bodies.begin(rng, moved.is_last)
    return np.concatenate(errors)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("environments", nargs="*", default=list(UPDATES))
    parser.add_argument("--folder", type=Path, default=Path("walking"), help="of what is made")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for env_id in arguments.environments:
        row = measured(env_id, arguments.folder)
        show_rows([row])
        table = Path(__file__).with_name("walking_inside.csv")
        keep_rows(table, [row], arguments, "environment", "seed")


if __name__ == "__main__":
    main()
