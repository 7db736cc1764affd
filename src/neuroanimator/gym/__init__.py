"""Emulators and tasks as Gymnasium environments. Needs the extra `[gym]`; importing this package registers them.

import gymnasium
import neuroanimator.gym

env = gymnasium.make("neuroanimator/fish-reach-v0")
"""

from __future__ import annotations

from neuroanimator.errors import ResourceError

try:
    import gymnasium
except ImportError:
    raise ResourceError(
        "Gymnasium is missing. Install it with: pip install 'neuroanimator[gym]'"
    ) from None

from neuroanimator.gym.envs import EmulatorEnv, EmulatorVectorEnv, RunningCost
from neuroanimator.gym.models import mjcf_of
from neuroanimator.zoo import SHIPPED

__all__ = ["EmulatorEnv", "EmulatorVectorEnv", "RunningCost", "mjcf_of", "register"]

TASK_NAMES = (
    "pendulum-swing-up", "truck-park", "lander-land",
    "fish-swim", "fish-turn", "fish-reach", "dolphin-swim", "dolphin-turn", "dolphin-reach", "dolphin-leap",
)  # fmt: skip
"""Of the environments with a goal; written down here, so that registering them imports no physics."""


def register() -> None:
    """Let `gymnasium.make` make environments of shipped emulators and of tasks: `neuroanimator/fish-reach-v0`."""
    names = {
        f"neuroanimator/{system}-{substeps}-v0": f"{system}-{substeps}"
        for system, substeps in SHIPPED
    }
    for env_id in names.keys() - gymnasium.registry.keys():
        gymnasium.register(
            env_id,
            entry_point="neuroanimator.gym.envs:EmulatorEnv",
            vector_entry_point="neuroanimator.gym.envs:EmulatorVectorEnv",
            kwargs={"emulator": names[env_id]},
        )
    tasks = {f"neuroanimator/{name}-v0": name for name in TASK_NAMES}
    for env_id in tasks.keys() - gymnasium.registry.keys():
        gymnasium.register(
            env_id,
            entry_point="neuroanimator.gym.task_envs:TaskEnv",
            vector_entry_point="neuroanimator.gym.task_envs:TaskVectorEnv",
            kwargs={"task": tasks[env_id]},
        )


# Gymnasium's convention: `make("neuroanimator.gym:neuroanimator/...")` imports this package and expects its names.
register()
