"""PPO of stable-baselines3 by the clock: what it costs, and what its policies are worth as it goes."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import (
    VecEnv,
    VecEnvWrapper,
    VecNormalize,
)

from benchmarks.walking.plain_policy import PlainPolicy
from neuroanimator.gym.vector_env import RowsVectorEnv

sys.path.append(str(Path(__file__).parents[2] / "examples" / "learning"))
from ppo import Rows

JUDGEMENTS = 16
"""How often a policy is judged in the time it has, at most."""

SOONER = 4
"""Factor by which it is done more often at first: a fast learner is done before the first sixteenth."""


@dataclass(frozen=True)
class Learning:
    """Settings of PPO. stable-baselines3's own where nothing is said; observations and rewards are normalised."""

    rows: int
    gamma: float
    settings: dict[str, Any]
    activation: str = "ReLU"


class Point(NamedTuple):
    """Where learning stands when a policy is judged."""

    seconds: float
    samples: int
    own_return: float
    mujoco_return: float
    """NaN where it is the same world."""


@dataclass
class Learnt:
    """What came of learning."""

    policy: PlainPolicy
    points: list[Point]
    stepping_seconds: float
    """In which the worlds were stepped."""
    acting_seconds: float
    """In which actions were drawn, and what happened was kept."""
    updating_seconds: float
    """In which the networks were trained."""
    has_arrived: bool
    """Whether its return in its own world came to the target."""

    @property
    def seconds(self) -> float:
        """All of it."""
        return self.stepping_seconds + self.acting_seconds + self.updating_seconds

    @property
    def samples(self) -> int:
        """Steps of the environment."""
        return self.points[-1].samples


class Clocked(VecEnvWrapper):
    """Counts the time steps take."""

    def __init__(self, venv: VecEnv, clock: Callable[[], float]):
        super().__init__(venv)
        self.clock = clock
        self.stepping_seconds = 0.0

    def reset(self) -> Any:
        return self.venv.reset()

    def step_wait(self) -> Any:
        begun = self.clock()
        result = self.venv.step_wait()
        self.stepping_seconds += self.clock() - begun
        return result


@dataclass
class Judge(BaseCallback):
    """Stops the clock, has policies judged, and ends when one arrives or time is up."""

    clocked: Clocked
    normaliser: VecNormalize
    judge: Callable[[PlainPolicy], tuple[float, float]]
    """Policy → (its return in its own world, on MuJoCo)."""
    target: float
    limit: float
    """How long learning may take [s]."""
    tell: Callable[[Point], None]
    judgements: int = JUDGEMENTS
    sampling_seconds: float = 0.0
    updating_seconds: float = 0.0
    points: list[Point] = field(default_factory=list)
    is_done: bool = False
    _since: float = 0.0
    _has_begun: bool = False
    _next: float = 0.0

    def __post_init__(self) -> None:
        BaseCallback.__init__(self)

    @property
    def seconds(self) -> float:
        """Learning time so far."""
        return self.sampling_seconds + self.updating_seconds

    def _on_rollout_start(self) -> None:
        now = self.clocked.clock()
        if self._has_begun:
            self.updating_seconds += now - self._since
            if self.seconds >= min(self._next, self.limit):
                self._judge()
        self._has_begun = True
        self._since = self.clocked.clock()

    def _on_rollout_end(self) -> None:
        now = self.clocked.clock()
        self.sampling_seconds += now - self._since
        self._since = now

    def _on_step(self) -> bool:
        return not self.is_done

    def _judge(self) -> None:
        interval = self.limit / self.judgements
        is_early = self.judgements == JUDGEMENTS and self.seconds < interval
        self._next = self.seconds + (interval / SOONER if is_early else interval)
        own, mujoco = self.judge(PlainPolicy.of(self.model, self.normaliser))
        point = Point(self.seconds, self.num_timesteps, own, mujoco)
        self.points.append(point)
        self.tell(point)
        self.is_done = own >= self.target or self.seconds >= self.limit


def learn(
    world: VecEnv,
    learning: Learning,
    seed: int,
    judge: Callable[[PlainPolicy], tuple[float, float]],
    target: float,
    limit: float,
    tell: Callable[[Point], None] = lambda point: None,
    clock: Callable[[], float] = time.perf_counter,
    judgements: int = JUDGEMENTS,
) -> Learnt:
    """Return what PPO learns in `world` until a policy's return there is `target`, or `limit` [s] are over."""
    world.seed(seed)
    clocked = Clocked(world, clock)
    normaliser = VecNormalize(clocked, gamma=learning.gamma)
    settings = dict(learning.settings)
    networks = dict(settings.pop("policy_kwargs", {}))
    networks["activation_fn"] = getattr(torch.nn, learning.activation)
    model = PPO(
        "MlpPolicy",
        normaliser,
        gamma=learning.gamma,
        seed=seed,
        device="cpu",
        policy_kwargs=networks,
        **settings,
    )
    callback = Judge(clocked, normaliser, judge, target, limit, tell, judgements)
    model.learn(10**12, callback=callback)
    policy = PlainPolicy.of(model, normaliser)
    world.close()
    return Learnt(
        policy,
        callback.points,
        clocked.stepping_seconds,
        callback.sampling_seconds - clocked.stepping_seconds,
        callback.updating_seconds,
        callback.points[-1].own_return >= target,
    )


def rows_world(env: RowsVectorEnv) -> VecEnv:
    """Return many rows at once as a world to learn in."""
    return Rows(env)
