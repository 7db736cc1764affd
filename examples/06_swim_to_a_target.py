"""A fish swims to a target and a dolphin leaps: found through emulators, proved on the true springs, written as GLB."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control.parameters import Periodic

SECONDS = 3.0


def perform(name: str, start: np.ndarray, *wishes: na.Term) -> na.Synthesis:
    """Find a periodic pattern of muscles for the wishes, and write how the true body moves by it."""
    emulator, system = na.Emulator.load(na.find_emulator(f"{name}-50")), na.load_system(name)
    steps = round(SECONDS / emulator.dt)
    found = na.synthesise(
        emulator, system, na.Objective.of(na.effort(0.1), na.smoothness(0.001), *wishes), start, steps=steps,
        parameters=Periodic.of(steps, emulator.dt, system.gait.period, system.bounds),
        first=0.7 * system.gait.controls(steps, emulator.dt, system.bounds), refinements=0,
    )  # fmt: skip
    motion = found.outcome
    clips = (na.make_clip(emulator, states) for states in (motion.physical, motion.emulated))
    na.write_glb(next(clips), Path(f"{name}.glb"), ghost=next(clips))
    print(f"{name}: {found.descent.iterations} iterations, {found.descent.seconds:.2f} s")
    return found


fish = na.load_system("fish")
target = na.read_pose(fish.structure, fish.rest).place + np.array([0.2, 0.12, 0.0])  # ahead and to the left
found = perform("fish", fish.rest, na.reach_place(fish, target, within=0.04))
there = na.read_pose(fish.structure, found.outcome.physical[-1]).place
print(f"the true fish ends {100 * np.linalg.norm(there - target):.1f} cm from its target")

dolphin = na.load_system("dolphin")
start = np.array(dolphin.rest)
start[2 : 3 * 23 : 3] -= 1.5  # under the surface
found = perform("dolphin", start, na.reach_place(dolphin, [0.6], axes="z", within=0.26, at=2.4))
heights = na.read_pose(dolphin.structure, found.outcome.physical).place[:, 2]
print(f"the true dolphin leaps: its middle rises {heights.max():.2f} m over the water")
