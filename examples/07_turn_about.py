"""A dolphin turns by a right angle while it swims: found through its emulator, proved on the true springs."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control import Spline

emulator = na.load_emulator("dolphin-50")
system = na.load_system("dolphin")
steps = round(3.0 / emulator.dt)
start = np.array(system.rest)
start[2 : 3 * 23 : 3] -= 2.0  # [m] under the surface
west = np.array([0.0, 1.0, 0.0])  # it points along x: to its left

objective = na.Objective.of(
    na.effort(0.1),
    na.smoothness(0.001),
    na.stay_upright(system),
    na.reach_heading(system, west, within=np.radians(3)),
)
descent = na.DescentOptions(
    parametrisation=Spline.of(steps, 30, system.bounds),  # 30 values a muscle, smoothly joined
    first=0.7 * system.gait.controls(steps, emulator.dt, system.bounds),
)
options = na.SearchOptions(descent, refinements=0)
controller = na.synthesise(emulator, system, objective, start, steps=steps, options=options)

spent = controller.spent
print(f"{spent.iterations} iterations, {spent.seconds:.2f} s, {spent.physics_steps} physics steps")
end = na.read_pose(system.structure, controller.outcome.physics_states[-1])
off = np.degrees(np.arccos(np.clip(end.forward @ west, -1, 1)))
roll = np.degrees(abs(end.roll))
print(f"the true dolphin ends {off:.1f}° off the wanted heading, rolled by {roll:.0f}°")
na.write_comparison(emulator, controller.outcome, Path("turn.glb"))
