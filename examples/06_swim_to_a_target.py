"""A fish swims to a target: found through its emulator, proved on the true springs, the emulated fish as a ghost."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control.descent.parametrisation import Periodic

emulator, system = na.Emulator.load(na.find_emulator("fish-50")), na.load_system("fish")
steps = round(3.0 / emulator.dt)
target = na.read_pose(system.structure, system.rest).position + np.array(
    [0.2, 0.12, 0.0]
)  # [m] ahead and to the left

found = na.synthesise(
    emulator, system,
    na.Objective.of(
        na.effort(0.1),
        na.smoothness(0.001),
        na.stay_upright(system),
        na.reach_position(system, target, within=0.04),
    ),
    system.rest, steps=steps, refinements=0,
    parametrisation=Periodic.of(steps, emulator.dt, system.gait.period, system.bounds),  # a wave along the body
    first=0.7 * system.gait.controls(steps, emulator.dt, system.bounds),
)  # fmt: skip

print(
    f"{found.descent.iterations} iterations, {found.descent.seconds:.2f} s, {found.physics_steps} physics steps"
)
end = na.read_pose(system.structure, found.outcome.physics_states[-1])
off, roll = 100 * np.linalg.norm(end.position - target), np.degrees(abs(end.roll))
print(f"the true fish ends {off:.1f} cm from its target, rolled by {roll:.0f}°")
na.write_comparison(emulator, found.outcome, Path("target.glb"))
