"""Tuned PPO and SAC beside `walking.py`: what they earn over minutes and steps, on the same cores.

python -m benchmarks.walking.walking_peers  60 minutes each in three environments: six hours
python -m benchmarks.walking.walking_peers Hopper-v5 --minutes 3 --seeds 0 1 --dry
python -m benchmarks.walking.walking_peers Ant-v5 --algorithms SAC --keep unfinished

Needs stable-baselines3: pip install stable-baselines3. Settings are those of rl-baselines3-zoo for the version of each
environment that it has (hyperparams/ppo.yml, v4; hyperparams/sac.yml, v3). PyTorch has one thread,
with which both learn faster here than with two. Time is a core's, CPU time of learning alone: it stands still while a policy is
judged, twenty times by sixteen of Gymnasium's episodes without noise. The best of these policies is judged by 100 episodes more,
as ours is. Several runs may share the cores. With `--keep FOLDER`, a run that was cut off goes on from where it was judged last.

Writes walking_peers.csv and walking_peers_curves.csv.
"""

from __future__ import annotations

import copy
import pickle
import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float

from benchmarks.harness import Rows, keep_rows, parser_of, show_rows
from benchmarks.walking.plain_policy import gymnasium_returns
from benchmarks.walking.walking import EPISODES, MINUTES, RESULTS

try:
    import torch
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
except ImportError as error:
    sys.exit(f"{error.name} is missing: pip install stable-baselines3")


RUN = ("environment", "algorithm", "seed", "minutes")
"""Columns that tell a run."""

WIDE = {
    "log_std_init": -2,
    "ortho_init": False,
    "activation_fn": torch.nn.ReLU,
    "net_arch": {"pi": [256, 256], "vf": [256, 256]},
}

ALGORITHMS: dict[str, Any] = {"PPO": PPO, "SAC": SAC}

SETTINGS: dict[tuple[str, str], dict[str, Any]] = {
    ("PPO", "Hopper-v5"): {
        "batch_size": 32,
        "n_steps": 512,
        "gamma": 0.999,
        "learning_rate": 9.80828e-5,
        "ent_coef": 0.00229519,
        "clip_range": 0.2,
        "n_epochs": 5,
        "gae_lambda": 0.99,
        "max_grad_norm": 0.7,
        "vf_coef": 0.835671,
        "policy_kwargs": WIDE,
    },
    ("PPO", "Walker2d-v5"): {
        "batch_size": 32,
        "n_steps": 512,
        "gamma": 0.99,
        "learning_rate": 5.05041e-5,
        "ent_coef": 0.000585045,
        "clip_range": 0.1,
        "n_epochs": 20,
        "gae_lambda": 0.95,
        "max_grad_norm": 1.0,
        "vf_coef": 0.871923,
    },
    ("PPO", "Ant-v5"): {},
    ("SAC", "Hopper-v5"): {"learning_starts": 10_000},
    ("SAC", "Walker2d-v5"): {"learning_starts": 10_000},
    ("SAC", "Ant-v5"): {"learning_starts": 10_000},
}
"""By algorithm and environment. PPO sees observations and rewards normalised."""

HOUR = 60.0
"""[min]"""

JUDGEMENTS = 20

JUDGED = 16
"""Number of episodes on the way."""

THREADS = 1
"""Number of PyTorch's threads."""


@dataclass
class Judge(BaseCallback):
    """Stops the clock to judge policies, keeps the best one, and ends learning after `limit` [s]."""

    env_id: str
    seed: int
    limit: float
    folder: Path | None
    """Folder in which the unfinished run is kept."""

    def __post_init__(self) -> None:
        super().__init__()
        self.points: Rows = []
        self.best: tuple[float, Any, Any] | None = None
        self.judging = 0.0
        self.began = 0.0
        self.before = 0.0
        """Core time of learning before the run was cut off [s]."""

    def _on_training_start(self) -> None:
        self.began = time.process_time()
        self.judging = 0.0
        self.next = self.before + self.limit / JUDGEMENTS

    @property
    def seconds(self) -> float:
        """Core time of learning so far [s]."""
        return self.before + time.process_time() - self.began - self.judging

    def _on_step(self) -> bool:
        if self.seconds >= self.next:
            self.judge()
        return self.seconds < self.limit

    def judge(self) -> None:
        """Take down what the policy earns, and keep it if it is the best."""
        seconds = self.seconds
        self.next = seconds + self.limit / JUDGEMENTS
        mean = float(np.mean(returns(self.model, self.env_id, JUDGED)))
        self.points.append(
            {
                "environment": self.env_id,
                "algorithm": type(self.model).__name__,
                "seed": self.seed,
                "steps": self.num_timesteps,
                "mean_return": mean,
                "seconds": seconds,
            }
        )
        show_rows(self.points[-1:])
        if self.best is None or mean > self.best[0]:
            weights = copy.deepcopy(self.model.policy.state_dict())
            self.best = (mean, weights, copy.deepcopy(_normaliser(self.model)))
        if self.folder is not None:
            keep_run(self, self.folder, seconds)
        self.judging = self.before + time.process_time() - self.began - seconds


def _normaliser(model: Any) -> Any:
    """Return the mean and deviation of observations, of a model that sees them normalised."""
    normalising = model.get_vec_normalize_env()
    return None if normalising is None else normalising.obs_rms


def returns(model: Any, env_id: str, episodes: int) -> list[float]:
    """Return what a model's mean actions earn in Gymnasium's environment itself."""
    normalising = model.get_vec_normalize_env()

    def act(observations: Float[np.ndarray, "B I"]) -> Float[np.ndarray, "B C"]:
        if normalising is not None:
            observations = normalising.normalize_obs(observations)
        actions, _ = model.predict(observations, deterministic=True)
        return actions

    return gymnasium_returns(act, env_id, range(episodes))


def fresh(algorithm: str, env_id: str, seed: int) -> Any:
    """Return a model that has learnt nothing."""
    settings = SETTINGS[algorithm, env_id]
    world: Any = DummyVecEnv([lambda: gymnasium.make(env_id)])
    if algorithm == "PPO":
        world = VecNormalize(world, gamma=settings.get("gamma", 0.99))
    return ALGORITHMS[algorithm]("MlpPolicy", world, seed=seed, device="cpu", **settings)


def keep_run(judge: Judge, folder: Path, seconds: float) -> None:
    """Write everything with which a run goes on after `seconds` of learning."""
    new = folder.with_suffix(".new")
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    model: Any = judge.model
    model.save(new / "model.zip")
    if model.get_vec_normalize_env() is not None:
        model.get_vec_normalize_env().save(str(new / "normaliser.pkl"))
    if isinstance(model, SAC):
        model.save_replay_buffer(new / "transitions.pkl")
    (new / "judge.pkl").write_bytes(pickle.dumps((judge.points, judge.best, seconds)))
    shutil.rmtree(folder, ignore_errors=True)
    new.rename(folder)


def go_on(algorithm: str, judge: Judge, folder: Path) -> Any:
    """Return the model of a run that was cut off, and give its judge what it knew."""
    world: Any = DummyVecEnv([lambda: gymnasium.make(judge.env_id)])
    if (folder / "normaliser.pkl").exists():
        world = VecNormalize.load(str(folder / "normaliser.pkl"), world)
    model = ALGORITHMS[algorithm].load(folder / "model.zip", env=world, device="cpu")
    if algorithm == "SAC":
        model.load_replay_buffer(folder / "transitions.pkl")
    judge.points, judge.best, judge.before = pickle.loads((folder / "judge.pkl").read_bytes())
    return model


def learnt(
    algorithm: str, env_id: str, seed: int, minutes: float, kept: Path | None
) -> tuple[dict[str, Any], Rows]:
    """Return (a row about the best policy, rows of the curve)."""
    folder = None if kept is None else kept / f"{env_id}-{algorithm}-{seed}"
    judge = Judge(env_id, seed, 60 * minutes, folder)
    if folder is not None and folder.exists():
        model = go_on(algorithm, judge, folder)
    else:
        model = fresh(algorithm, env_id, seed)
    model.learn(10**12, callback=judge, reset_num_timesteps=False)
    seconds = judge.seconds
    judge.judge()
    assert judge.best is not None
    _, weights, normaliser = judge.best
    model.policy.load_state_dict(weights)
    if normaliser is not None:
        model.get_vec_normalize_env().obs_rms = normaliser
    found = returns(model, env_id, EPISODES)
    row = {
        "environment": env_id,
        "algorithm": algorithm,
        "seed": seed,
        "minutes": minutes,
        "seconds": seconds,
        "episodes": EPISODES,
        "mean_return": float(np.mean(found)),
        "least_return": float(np.min(found)),
        "largest_return": float(np.max(found)),
        "steps": model.num_timesteps,
    }
    return row, [point | {"minutes": minutes} for point in judge.points]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("environments", nargs="*", default=list(MINUTES))
    parser.add_argument("--algorithms", nargs="*", default=list(ALGORITHMS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--minutes", type=float, default=HOUR)
    parser.add_argument("--keep", type=Path, help="folder of unfinished runs, which go on")
    arguments = parser.parse_args()
    torch.set_num_threads(THREADS)
    for env_id in arguments.environments:
        for algorithm in arguments.algorithms:
            for seed in arguments.seeds:
                row, curve = learnt(algorithm, env_id, seed, arguments.minutes, arguments.keep)
                show_rows([row])
                keep_rows(RESULTS / "walking_peers.csv", [row], arguments, *RUN)
                keep_rows(RESULTS / "walking_peers_curves.csv", curve, arguments, *RUN)


if __name__ == "__main__":
    main()
