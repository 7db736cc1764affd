"""A fish swims to a target: found through its emulator, proved on the true springs, the emulated fish as a ghost."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control import Periodic

emulator = na.load_emulator("fish-50")
system = na.load_system("fish")
steps = round(3.0 / emulator.dt)
ahead_left = np.array([0.2, 0.12, 0.0])  # [m]
target = na.read_pose(system.structure, system.rest).position + ahead_left

objective = na.Objective.of(
    na.effort(0.1),
    na.smoothness(0.001),
    na.stay_upright(system),
    na.reach_position(system, target, within=0.04),
)
descent = na.DescentOptions(
    # A wave along the body: one frequency for all muscles.
    parametrisation=Periodic.of(steps, emulator.dt, system.gait.period, system.bounds),
    first=0.7 * system.gait.controls(steps, emulator.dt, system.bounds),
)
options = na.SearchOptions(descent, refinements=0)
controller = na.synthesise(emulator, system, objective, system.rest, steps=steps, options=options)

spent = controller.spent
print(f"{spent.iterations} iterations, {spent.seconds:.2f} s, {spent.physics_steps} physics steps")
end = na.read_pose(system.structure, controller.outcome.physics_states[-1])
off = 100 * np.linalg.norm(end.position - target)
roll = np.degrees(abs(end.roll))
print(f"on the physics the fish ends {off:.1f} cm from its target, rolled by {roll:.0f}°")
na.write_comparison(emulator, controller.outcome, Path("target.glb"))
