"""A dolphin turns by a right angle while it swims: found through its emulator, proved on the true springs."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control.descent.parametrisation import Spline

emulator, system = na.Emulator.load(na.find_emulator("dolphin-50")), na.load_system("dolphin")
steps = round(3.0 / emulator.dt)
start = np.array(system.rest)
start[2 : 3 * 23 : 3] -= 2.0  # [m] under the surface
west = np.array([0.0, 1.0, 0.0])  # it points along x: to its left

found = na.synthesise(
    emulator, system,
    na.Objective.of(
        na.effort(0.1),
        na.smoothness(0.001),
        na.stay_upright(system),
        na.reach_heading(system, west, within=np.radians(3)),
    ),
    start, steps=steps, refinements=0,
    parametrisation=Spline.of(steps, 30, system.bounds),  # 30 values a muscle, smoothly joined
    first=0.7 * system.gait.controls(steps, emulator.dt, system.bounds),
)  # fmt: skip

print(
    f"{found.descent.iterations} iterations, {found.descent.seconds:.2f} s, {found.physics_steps} physics steps"
)
end = na.read_pose(system.structure, found.outcome.physics_states[-1])
off, roll = np.degrees(np.arccos(np.clip(end.forward @ west, -1, 1))), np.degrees(abs(end.roll))
print(f"the true dolphin ends {off:.1f}° off the wanted heading, rolled by {roll:.0f}°")
na.write_comparison(emulator, found.outcome, Path("turn.glb"))
