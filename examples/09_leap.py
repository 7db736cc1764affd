"""A dolphin leaps out of the water: found through its emulator, proved on the true springs."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control.parameters import Periodic

emulator, system = na.Emulator.load(na.find_emulator("dolphin-50")), na.load_system("dolphin")
steps = round(3.0 / emulator.dt)
start = np.array(system.rest)
start[2 : 3 * 23 : 3] -= 1.5  # [m] under the surface

found = na.synthesise(
    emulator, system,
    na.Objective.of(
        na.effort(0.1),
        na.smoothness(0.001),
        na.reach_place(system, [0.6], axes="z", within=0.26, at=2.4),  # [m] over the water, at 2.4 s
    ),
    start, steps=steps, refinements=0,
    parameters=Periodic.of(steps, emulator.dt, system.gait.period, system.bounds),
    first=0.7 * system.gait.controls(steps, emulator.dt, system.bounds),
)  # fmt: skip

print(f"{found.descent.iterations} iterations, {found.descent.seconds:.2f} s, {found.physics_steps} physics steps")
heights = na.read_pose(system.structure, found.outcome.physical).place[:, 2]
print(f"the true dolphin leaps: its middle rises {heights.max():.2f} m over the water")
na.write_proof(emulator, found.outcome, Path("leap.glb"))
