"""A fish finds how to swim faster than its gait, for little effort: each muscle's tempo, strength and phase."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control import Periodic

emulator = na.load_emulator("fish-50")
system = na.load_system("fish")
steps = round(3.0 / emulator.dt)
gait = system.gait.controls(steps, emulator.dt, system.bounds)
ahead = np.array([1.0, 0.0, 0.0])

objective = na.Objective.of(
    na.effort(0.1),
    na.smoothness(0.001),
    na.stay_upright(system),
    na.travel(system, ahead, 0.5, within=0.1),
)
descent = na.DescentOptions(
    method="adam",
    parametrisation=Periodic.of(steps, emulator.dt, system.gait.period, system.bounds),
    first=0.7 * gait,  # at full strength the muscles are at their bounds, where nothing has a slope
)
options = na.SearchOptions(descent, refinements=0)
controller = na.synthesise(emulator, system, objective, system.rest, steps=steps, options=options)


def distance(states: np.ndarray) -> float:
    """Return the distance [m] that the fish swims along x."""
    position = na.read_pose(system.structure, states[[0, -1]]).position
    return float((position[1] - position[0]) @ ahead)


usual = distance(system.simulate(system.rest[None], gait[None], emulator.dt).states[0])
spent = controller.spent
print(f"{spent.iterations} iterations, {spent.seconds:.2f} s, {spent.physics_steps} physics steps")
reached = distance(controller.outcome.physics_states)
print(
    f"in 3 s on the physics the fish travels {100 * reached:.0f} cm, by its gait {100 * usual:.0f} cm"
)
roll = np.degrees(abs(na.read_pose(system.structure, controller.outcome.physics_states[-1]).roll))
print(f"it ends rolled by {roll:.0f}°")
na.write_comparison(emulator, controller.outcome, Path("fast.glb"))
