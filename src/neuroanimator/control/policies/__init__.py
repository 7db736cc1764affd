"""Motor controllers that are learnt once, what steers them, and how bodies behave that steer themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from neuroanimator.lazy import lazy_names

if TYPE_CHECKING:
    from neuroanimator.control.policies.behaviours import (
        Tank,
        give_way,
        keep_apart,
        limit_angles,
        prioritise,
        pursue,
        school,
        shoal,
        stay_inside,
        steer_along,
        wander,
    )
    from neuroanimator.control.policies.closed_loop import rollout_on_emulator, rollout_on_physics
    from neuroanimator.control.policies.pilot import Pilot, PilotFrame
    from neuroanimator.control.policies.policy import Policy
    from neuroanimator.control.policies.policy_file import load_policy
    from neuroanimator.control.policies.policy_seeds import train_policies
    from neuroanimator.control.policies.policy_training import PolicyTraining, train_policy
    from neuroanimator.control.policies.steering import (
        SteeringTarget,
        steer_down,
        steer_forward,
        steer_left,
    )

_HOMES = {
    "Policy": "policy",
    "load_policy": "policy_file",
    "PolicyTraining": "policy_training",
    "train_policy": "policy_training",
    "train_policies": "policy_seeds",
    "Pilot": "pilot",
    "PilotFrame": "pilot",
    "SteeringTarget": "steering",
    "steer_forward": "steering",
    "steer_left": "steering",
    "steer_down": "steering",
    "Tank": "behaviours",
    "wander": "behaviours",
    "pursue": "behaviours",
    "stay_inside": "behaviours",
    "school": "behaviours",
    "keep_apart": "behaviours",
    "give_way": "behaviours",
    "prioritise": "behaviours",
    "limit_angles": "behaviours",
    "shoal": "behaviours",
    "steer_along": "behaviours",
    "rollout_on_emulator": "closed_loop",
    "rollout_on_physics": "closed_loop",
}

__all__ = [  # noqa: RUF022 (by what they are for)
    # Policies.
    "Policy",
    "load_policy",
    "PolicyTraining",
    "train_policy",
    "train_policies",
    "Pilot",
    "PilotFrame",
    # Steering.
    "SteeringTarget",
    "steer_forward",
    "steer_left",
    "steer_down",
    # Behaviours.
    "Tank",
    "wander",
    "pursue",
    "stay_inside",
    "school",
    "keep_apart",
    "give_way",
    "prioritise",
    "limit_angles",
    "shoal",
    "steer_along",
    # Closed loops.
    "rollout_on_emulator",
    "rollout_on_physics",
]

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
