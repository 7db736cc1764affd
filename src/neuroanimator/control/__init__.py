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
    from neuroanimator.control.synthesis.attempt import SearchCost
    from neuroanimator.control.synthesis.objective_file import read_objective, synthesise_file
    from neuroanimator.control.synthesis.receding_horizon import (
        ControlledMotion,
        EmulatorPlant,
        PhysicsPlant,
        Plan,
        Planner,
        all_along,
        control_plant,
        moved_on,
    )
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
    "Planner": "synthesis.receding_horizon",
    "Plan": "synthesis.receding_horizon",
    "control_plant": "synthesis.receding_horizon",
    "ControlledMotion": "synthesis.receding_horizon",
    "EmulatorPlant": "synthesis.receding_horizon",
    "PhysicsPlant": "synthesis.receding_horizon",
    "all_along": "synthesis.receding_horizon",
    "moved_on": "synthesis.receding_horizon",
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
    "all_along",
    "moved_on",
]

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
