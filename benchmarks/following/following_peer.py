"""PPO of stable-baselines3 beside `following.py`: a human learns to follow a walk, with ten times as much of a core's time.

python -m benchmarks.following.following_peer                              ours, then PPO: an hour and a half of a core
python -m benchmarks.following.following_peer PPO --seed 1                 PPO alone, beside the row that ours has in the table
python -m benchmarks.following.following_peer PPO --core-seconds 60 --dry  try it

Needs stable-baselines3: pip install stable-baselines3. Ours is `neuroanimator policy`, as in `following.py`. PPO has the same
body, clip, rewards, ends and starts, the same observations, the same number of bodies and steps of each between two updates,
networks of the same widths, and actions that are the same offsets of the servos' targets, clipped to the reach instead of
squashed into it. All other settings are those of rl-baselines3-zoo for Humanoid-v4 (hyperparams/ppo.yml), the nearest body
that it has. The best policy on the way, by sixteen episodes without noise, is judged as in `following.py`.

Core seconds are CPU time of all threads: of PPO that of learning alone, of ours that of the whole command. PPO's clock stands
still while policies are judged. Ctrl-C ends PPO early, and what it has learnt is judged.

Writes following_peer.csv and following_peer_curves.csv.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from jaxtyping import Array, Float

from benchmarks.following.following import UPDATES, curve_of, judged
from benchmarks.following.following import learn as learn_ours
from benchmarks.harness import HUMAN, Rows, keep_rows, parser_of, read_rows, show_rows
from neuroanimator.cli.policy import first_emulator
from neuroanimator.control.policies.reference_motion import ReferenceMotion
from neuroanimator.control.policies.state_policy import (
    EPSILON,
    StatePolicy,
    View,
    load_state_policy,
)
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.gym.bodies import Bodies, episodes_of
from neuroanimator.gym.policy_task import PolicyTask, task_of_policy, task_to_learn
from neuroanimator.gym.state_rows import Stepper, physics_stepper
from neuroanimator.physics import load_system
from neuroanimator.physics.loading import resolve
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem

try:
    import torch

    from benchmarks.walking.plain_policy import TINY, PlainPolicy
    from benchmarks.walking.ppo import Learning, Point, learn, rows_world
except ImportError as error:
    sys.exit(f"{error.name} is missing: pip install stable-baselines3")


TOML = HUMAN / "human.toml"

TABLE = Path(__file__).with_name("following_peer.csv")

CURVES = Path(__file__).with_name("following_peer_curves.csv")

RUN = ("method", "seed")
"""Columns that tell a run."""

OURS = "ours"

PEER = "PPO"

TIMES = 10
"""Core seconds of PPO, in those of ours."""

ZOO: dict[str, Any] = {
    "batch_size": 256,
    "learning_rate": 3.56987e-5,
    "ent_coef": 0.00238306,
    "clip_range": 0.3,
    "n_epochs": 5,
    "gae_lambda": 0.9,
    "max_grad_norm": 2,
    "vf_coef": 0.431892,
}
"""Settings of rl-baselines3-zoo for Humanoid-v4, as are those of `NETWORKS`, and `DISCOUNT`."""

NETWORKS: dict[str, Any] = {"log_std_init": -2, "ortho_init": False}

DISCOUNT = 0.95

THREADS = 1
"""Number of PyTorch's threads. On two cores with other work two threads wait for each other, and take many times the CPU time."""

JUDGED = 16
"""Number of episodes on the way."""

MOST = 1 - 1e-6
"""Largest action of which tanh has an inverse in single precision, within ±1."""


class RectifiedNetwork(eqx.Module):
    """A network of stable-baselines3 as that of a `StatePolicy`, whose tanh turns its outputs into clipped actions."""

    weights: tuple[Float[Array, "I O"], ...]
    biases: tuple[Float[Array, " O"], ...]

    def __call__(self, rows: Float[Array, "*B I"]) -> Float[Array, "*B O"]:
        for weights, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            rows = jax.nn.relu(rows @ weights + bias)
        actions = rows @ self.weights[-1] + self.biases[-1]
        return jnp.arctanh(jnp.clip(actions, -MOST, MOST))


class FollowingRows(VectorEnv):
    """Bodies that follow a motion; actions within ±1 are offsets of their servos' targets, in units of the reach."""

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - never changed

    def __init__(self, task: PolicyTask, stepper: Stepper, emulator: Emulator):
        self.task = task
        self.stepper = stepper
        self.emulator = emulator
        self.num_envs = task.learning.bodies
        assert task.motion is not None
        self.motion = task.motion
        self.view = view_of(task)
        size = len(self.view.mean)
        self.single_observation_space = Box(-np.inf, np.inf, (size,), np.float32)
        self.single_action_space = Box(-1.0, 1.0, (emulator.control.size,), np.float32)

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        self._rng = np.random.default_rng(seed)
        self._bodies = Bodies(
            self.stepper, self.task.rules, self.emulator, self._rng, self.num_envs
        )
        return self._observe(self._bodies.states), {}

    def step(self, actions: Float[np.ndarray, "N C"]) -> Any:
        aims = _aims(self.motion, as_jax(self._bodies.states), as_jax(actions))
        moved = self._bodies.step(np.asarray(aims, float))
        last = self._observe(self._bodies.states)
        self._bodies.begin(self._rng, moved.is_last)
        observations = last
        if moved.is_last.any():
            observations = self._observe(self._bodies.states)
        is_cut = moved.is_last & ~moved.is_over
        return observations, moved.rewards, moved.is_over, is_cut, {"final_obs": last}

    def _observe(self, states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, "N O"]:
        return np.asarray(_observed(self.view, as_jax(states)))


def view_of(task: PolicyTask) -> View:
    """Return what our policies observe, without normalisation."""
    assert task.motion is not None
    return View.fresh(task.motion.shown, task.motion)


def policy_of(plain: PlainPolicy, task: PolicyTask, emulator: Emulator) -> StatePolicy:
    """Return what PPO has learnt as one of our policies, to be judged as these are."""
    view = view_of(task)
    deviation = np.sqrt(plain.variance + TINY) - EPSILON
    normalised = View(as_jax(plain.mean), as_jax(deviation), view.entries, view.reference)
    assert plain.is_rectified
    network: Any = RectifiedNetwork(
        tuple(as_jax(weights.T) for weights in plain.weights),
        tuple(as_jax(biases) for biases in plain.biases),
    )
    return StatePolicy(emulator, normalised, network)


def settings_of(task: PolicyTask) -> Learning:
    """Return PPO's settings, with our sizes."""
    ours = task.learning
    widths = {"pi": list(ours.policy_widths), "vf": list(ours.critic_widths)}
    settings = ZOO | {"n_steps": ours.horizon, "policy_kwargs": NETWORKS | {"net_arch": widths}}
    return Learning(ours.bodies, DISCOUNT, settings)


@dataclass
class Progress:
    """Judges what PPO learns, keeps the best policy and writes the curve as it goes."""

    task: PolicyTask
    stepper: Stepper
    emulator: Emulator
    seed: int
    keep: Path | None
    options: argparse.Namespace
    best: StatePolicy | None = None
    curve: Rows = field(default_factory=list)
    began: float = field(default_factory=time.perf_counter)

    def judge(self, plain: PlainPolicy) -> tuple[float, float]:
        """Return (mean return of episodes without noise, NaN: there is no other world)."""
        policy = policy_of(plain, self.task, self.emulator)
        returns = episodes_of(policy, self.stepper, self.task.rules, JUDGED, self.seed).returns
        mean = float(returns.mean())
        if self.best is None or mean > max(point["mean_return"] for point in self.curve):
            self.best = policy
            if self.keep is not None:
                eqx.tree_serialise_leaves(self.keep, policy)
        return mean, float("nan")

    def tell(self, point: Point) -> None:
        """Take down where learning stands; seconds are wall-clock time, judging included."""
        self.curve.append(
            {
                "method": PEER,
                "seed": self.seed,
                "steps": point.samples,
                "mean_return": point.own_return,
                "core_seconds": point.seconds,
                "seconds": time.perf_counter() - self.began,
            }
        )
        show_rows(self.curve[-1:])
        keep_rows(CURVES, self.curve, self.options, *RUN)


def our_row(system: MujocoSystem, options: argparse.Namespace) -> dict[str, Any]:
    """Return what `neuroanimator policy` learns, and write its curve."""
    seed = options.seed
    labels = {"method": OURS, "seed": seed}
    with TemporaryDirectory() as place:
        file, core_seconds, _ = learn_ours("walk", seed, UPDATES["walk"], Path(place))
        curve = curve_of(file, labels)
        policy = load_state_policy(file)
    kept = ("method", "seed", "steps", "mean_return", "seconds")
    keep_rows(CURVES, [{name: point[name] for name in kept} for point in curve], options, *RUN)
    return labels | {
        "core seconds": core_seconds,
        "seconds": curve[-1]["seconds"],
        "transitions": curve[-1]["steps"],
        **judged(policy, task_of_policy(policy, file, system), system),
    }


def peer_row(
    system: MujocoSystem, core_seconds: float, options: argparse.Namespace
) -> dict[str, Any]:
    """Return what PPO learns within `core_seconds`."""
    seed = options.seed
    name, definition, _ = resolve(str(TOML))
    task = task_to_learn(definition, TOML, system)
    with TemporaryDirectory() as place:
        # It describes states and controls, and is not run.
        emulator = first_emulator(name, definition, task, Path(place) / "peer", seed)
    stepper = physics_stepper(system, system.scheme, emulator.dt)
    rows: Any = FollowingRows(task, stepper, emulator)
    progress = Progress(task, stepper, emulator, seed, options.keep, options)
    try:
        learn(
            rows_world(rows), settings_of(task), seed, progress.judge, np.inf, core_seconds,
            progress.tell, time.process_time,
        )  # fmt: skip
    except KeyboardInterrupt:
        print("stopped early")
    assert progress.best is not None
    last = progress.curve[-1]
    return {
        "method": PEER,
        "seed": seed,
        "core seconds": last["core_seconds"],
        "seconds": last["seconds"],
        "transitions": last["steps"],
        **judged(progress.best, task, system),
    }


def core_seconds_of_ours(seed: int) -> float:
    """Return the core seconds of our row in the table."""
    for row in read_rows(TABLE):
        if row["method"] == OURS and row["seed"] == str(seed):
            return float(row["core seconds"])
    sys.exit(f"{TABLE} has no row of ours with seed {seed}: run it with '{OURS}' first.")


@eqx.filter_jit
def _observed(view: View, states: Float[Array, "N S"]) -> Float[Array, "N O"]:
    return view.of(states)


@eqx.filter_jit
def _aims(
    motion: ReferenceMotion, states: Float[Array, "N S"], actions: Float[Array, "N C"]
) -> Float[Array, "N C"]:
    return motion.target(states) + motion.reach * actions


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("methods", nargs="*", default=[OURS, PEER])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--core-seconds", type=float, help="of PPO, instead of ten times ours")
    parser.add_argument("--keep", type=Path, help="file for PPO's policy")
    arguments = parser.parse_args()
    torch.set_num_threads(THREADS)
    system = load_system(str(TOML))
    assert isinstance(system, MujocoSystem)
    if OURS in arguments.methods:
        row = our_row(system, arguments)
        show_rows([row])
        keep_rows(TABLE, [row], arguments, *RUN)
    if PEER in arguments.methods:
        limit = arguments.core_seconds or TIMES * core_seconds_of_ours(arguments.seed)
        row = peer_row(system, limit, arguments)
        show_rows([row])
        keep_rows(TABLE, [row], arguments, *RUN)


if __name__ == "__main__":
    main()
