"""The pendulum's swing-up, which many tests use as their objective."""

from __future__ import annotations

import numpy as np

from neuroanimator.control.objective.costs import effort
from neuroanimator.control.objective.goals import is_reached, reach_goal
from neuroanimator.control.objective.objective import Moments, Objective
from neuroanimator.physics.rigid.pendulum import active_pendulum

PENDULUM = active_pendulum()


def stand_upright(
    effort_weight: float = 1.0, state_weight: float = 1.0, times: tuple[float, ...] = ()
) -> Objective:
    """Return the objective 'all three links point up and stand still' at the end or at `times` [s]."""
    goal = PENDULUM.goals["upright"]
    upright = reach_goal(PENDULUM, goal, when=Moments(times), weight=state_weight)
    return Objective.of(effort(effort_weight), upright)


def is_upright(state: np.ndarray) -> bool:
    """Return whether all three links of the pendulum in `state` (6,) point up and are nearly still."""
    return is_reached(PENDULUM, "upright", state)
