"""A fish finds how to swim faster than its gait, for little effort: each muscle's tempo, strength and phase."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control.descent.parametrisation import Periodic

emulator, system = na.Emulator.load(na.find_emulator("fish-50")), na.load_system("fish")
steps = round(3.0 / emulator.dt)
gait = system.gait.controls(steps, emulator.dt, system.bounds)
ahead = np.array([1.0, 0.0, 0.0])

found = na.synthesise(
    emulator, system,
    na.Objective.of(
        na.effort(0.1), na.smoothness(0.001), na.stay_upright(system), na.travel(system, ahead, 0.5, within=0.1)
    ),
    system.rest, steps=steps, refinements=0, method="adam",
    parametrisation=Periodic.of(steps, emulator.dt, system.gait.period, system.bounds),
    first=0.7 * gait,  # at full strength the muscles are at their bounds, where nothing has a slope
)  # fmt: skip


def way(states: np.ndarray) -> float:
    """Return how far [m] the fish comes along x."""
    position = na.read_pose(system.structure, states[[0, -1]]).position
    return float((position[1] - position[0]) @ ahead)


usual = way(system.simulate(system.rest[None], gait[None], emulator.dt).states[0])
print(
    f"{found.descent.iterations} iterations, {found.descent.seconds:.2f} s, {found.physics_steps} physics steps"
)
print(
    f"in 3 s the true fish comes {100 * way(found.outcome.physics_states):.0f} cm; by its gait {100 * usual:.0f} cm"
)
roll = np.degrees(abs(na.read_pose(system.structure, found.outcome.physics_states[-1]).roll))
print(f"it ends rolled by {roll:.0f}°")
na.write_comparison(emulator, found.outcome, Path("fast.glb"))
