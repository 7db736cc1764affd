"""Finding controls: what a descent varies, obstacles, and planning again and again.

    from neuroanimator import control

    options = na.DescentOptions(parametrisation=control.Spline.of(steps, 16, system.bounds))

Cost terms and the search itself are names of `neuroanimator`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from neuroanimator.lazy import lazy_names

if TYPE_CHECKING:
    from neuroanimator.control.descent.descend import Descent
    from neuroanimator.control.descent.gradient_check import GradientTrust, gradient_trust
    from neuroanimator.control.descent.options import DescentOptions
    from neuroanimator.control.descent.parametrisation import (
        EachStep,
        Parametrisation,
        Periodic,
        Spline,
        Steered,
    )
    from neuroanimator.control.objective.obstacles import Zone
    from neuroanimator.control.objective.trajectory import Trajectory
    from neuroanimator.control.planning.environments import (
        DmEnvironment,
        Environment,
        Episode,
        control_environment,
        mujoco_state,
    )
    from neuroanimator.control.planning.learn import learn_from
    from neuroanimator.control.planning.planner import Plan, Planner, moved_on
    from neuroanimator.control.planning.plants import (
        ControlledMotion,
        EmulatorPlant,
        PhysicsPlant,
        control_plant,
    )
    from neuroanimator.control.planning.pursue import Pursuit, pursue_goal
    from neuroanimator.control.synthesis.attempt import SearchCost
    from neuroanimator.control.synthesis.objective_file import read_objective, synthesise_file
    from neuroanimator.control.synthesis.replay import Replay
    from neuroanimator.control.synthesis.synthesise import synthesise_goal

_HOMES = {
    "Parametrisation": "descent.parametrisation",
    "EachStep": "descent.parametrisation",
    "Spline": "descent.parametrisation",
    "Periodic": "descent.parametrisation",
    "Steered": "descent.parametrisation",
    "DescentOptions": "descent.options",
    "Descent": "descent.descend",
    "GradientTrust": "descent.gradient_check",
    "gradient_trust": "descent.gradient_check",
    "Zone": "objective.obstacles",
    "Trajectory": "objective.trajectory",
    "SearchCost": "synthesis.attempt",
    "Replay": "synthesis.replay",
    "read_objective": "synthesis.objective_file",
    "synthesise_file": "synthesis.objective_file",
    "synthesise_goal": "synthesis.synthesise",
    "Planner": "planning.planner",
    "Plan": "planning.planner",
    "control_plant": "planning.plants",
    "ControlledMotion": "planning.plants",
    "EmulatorPlant": "planning.plants",
    "PhysicsPlant": "planning.plants",
    "Environment": "planning.environments",
    "DmEnvironment": "planning.environments",
    "Episode": "planning.environments",
    "control_environment": "planning.environments",
    "mujoco_state": "planning.environments",
    "learn_from": "planning.learn",
    "Pursuit": "planning.pursue",
    "pursue_goal": "planning.pursue",
    "moved_on": "planning.planner",
}

__all__ = [  # noqa: RUF022 (by what they are for)
    # What a descent varies.
    "Parametrisation",
    "EachStep",
    "Spline",
    "Periodic",
    "Steered",
    "DescentOptions",
    "Descent",
    "GradientTrust",
    "gradient_trust",
    # Objectives.
    "Zone",
    "Trajectory",
    # Searches.
    "SearchCost",
    "Replay",
    "read_objective",
    "synthesise_file",
    "synthesise_goal",
    # Planning again at every super step.
    "Planner",
    "Plan",
    "control_plant",
    "ControlledMotion",
    "EmulatorPlant",
    "PhysicsPlant",
    "moved_on",
    "Pursuit",
    "pursue_goal",
    # In somebody else's environment.
    "Environment",
    "DmEnvironment",
    "Episode",
    "control_environment",
    "mujoco_state",
    "learn_from",
]

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
