"""The motion a system is shown with when nobody says anything: worth a look, and never random twitching if that can be helped."""

from __future__ import annotations

import numpy as np

from neuroanimator import Emulator, NeuroAnimatorError, is_reached
from neuroanimator.animation.motion import Drive, random_drive, shipped_drive
from neuroanimator.control.objective.goals import goal_start
from neuroanimator.control.synthesis.synthesise import synthesise_goal
from neuroanimator.systems.system import System


def opening_drive(emulator: Emulator, system: System) -> Drive:
    """Return what `animate` shows of what ships and of a body with a gait; of another what reaches a goal of `system`.

    A goal with a start of its own comes first: its motion goes somewhere.
    """
    shipped = shipped_drive(emulator)
    if shipped is not None:
        return shipped
    if emulator.gait is None:
        for name in _goals_away_from_start(system):
            try:
                found = synthesise_goal(emulator, name, refinements=0, goals_from=system)
            except NeuroAnimatorError:
                continue  # of somebody's own system: it may be out of reach
            start = goal_start(system, name)
            # What the physics corrected may miss on the emulator, which is what is shown.
            for controls in (found.controls, found.descent.controls):
                states = np.asarray(emulator.rollout(start, controls), float)
                if is_reached(system, name, states[-1]):
                    return Drive(start, np.array(controls, float))
    return random_drive(emulator, None, 0)


def _goals_away_from_start(system: System) -> list[str]:
    """Return the names of goals that are not reached where they begin, those with a start of their own first."""
    names = []
    for name in sorted(system.goals, key=lambda name: not system.goals[name].start):
        if not is_reached(system, name, goal_start(system, name)):
            names.append(name)
    return names
