"""Emulators and tasks as Gymnasium environments. Needs the extra `[gym]`; importing this package registers them.

import gymnasium

env = gymnasium.make("neuroanimator.gym:neuroanimator/fish-reach-v0")

The part before the colon is imported first: Gymnasium 1 no longer finds packages itself.
"""

from __future__ import annotations

from neuroanimator.errors import ResourceError

try:
    import gymnasium
except ImportError:
    raise ResourceError(
        "Gymnasium is missing. Install it with: pip install 'neuroanimator[gym]'"
    ) from None

from neuroanimator.control.policies.state_policy import StatePolicy, load_state_policy
from neuroanimator.files.zoo import SHIPPED
from neuroanimator.gym.envs import EmulatorEnv, EmulatorVectorEnv, PhysicsVectorEnv
from neuroanimator.gym.learner import PolicyLearning
from neuroanimator.gym.locomotion import gymnasium_task, locomotion_rules
from neuroanimator.gym.models import mjcf_of
from neuroanimator.gym.rules import EpisodeRules, RunningCost

__all__ = [
    "EmulatorEnv",
    "EmulatorVectorEnv",
    "EpisodeRules",
    "PhysicsVectorEnv",
    "PolicyLearning",
    "RunningCost",
    "StatePolicy",
    "gymnasium_task",
    "load_state_policy",
    "locomotion_rules",
    "mjcf_of",
    "register",
]

TASK_NAMES = (
    "pendulum-swing-up", "truck-park", "lander-land",
    "fish-swim", "fish-turn", "fish-reach", "trout-swim", "trout-turn", "trout-reach",
    "dolphin-swim", "dolphin-turn", "dolphin-reach", "dolphin-leap", "orca-leap",
)  # fmt: skip
"""Tasks that have environments; listed here, so that registering them imports no physics."""


def register() -> None:
    """Register environments of shipped emulators and of tasks for `gymnasium.make`: `neuroanimator/fish-reach-v0`."""
    for system, substeps in SHIPPED:
        for name in (system, f"{system}-{substeps}"):
            _register(name, "envs:EmulatorEnv", "envs:EmulatorVectorEnv", emulator=name)
    for name in TASK_NAMES:
        _register(name, "task_envs:TaskEnv", "task_envs:TaskVectorEnv", task=name)


def _register(name: str, single_env: str, vector_env: str, **arguments: str) -> None:
    """Register `neuroanimator/<name>-v0`, made by these classes of this package with these arguments, if it is missing."""
    env_id = f"neuroanimator/{name}-v0"
    if env_id in gymnasium.registry:
        return
    gymnasium.register(
        env_id,
        entry_point=f"{__name__}.{single_env}",
        vector_entry_point=f"{__name__}.{vector_env}",
        kwargs=arguments,
    )


# Gymnasium's convention: `make("neuroanimator.gym:neuroanimator/...")` imports this package and expects its names.
register()
