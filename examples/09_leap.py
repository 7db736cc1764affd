"""A dolphin leaps clear of the water and dives in nose first: found by its emulator, proved on the true springs."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control.descent.parametrisation import Steered
from neuroanimator.state.layout import Bounds
from neuroanimator.state.pose import read_heights

DEPTH, SECONDS, TEMPO = (
    4.2,
    4.2,
    1.5,
)  # [m] a run-up from so far under its rest, [s], times the gait's frequency
TOP, ENTRY = 3.3, 3.85  # [s] when it is highest, and when it dives in again
STEEP = np.radians(50)

emulator, system = na.Emulator.load(na.find_emulator("dolphin-50")), na.load_system("dolphin")
steps = round(SECONDS / emulator.dt)
start = np.array(system.rest)
start[2 : 3 * 23 : 3] -= DEPTH

# What pulls left and right alike cannot twist it in flight: only muscles of the gait may pull.
bounds = Bounds.symmetric(np.where(np.array(system.gait.amplitudes) == 0, 1e-3, 1.0))

# A first guess: its gait, but faster, and its back bent upward at first.
gait = system.gait
times = np.arange(steps) * emulator.dt
bend = np.interp(times, [0.0, 0.8, 2.4, SECONDS], [0.0, 0.32, 0.0, -0.09])
first = 0.8 * gait.controls(steps, emulator.dt, bounds, tempo=TEMPO) + bend[:, None] * np.sign(
    gait.amplitudes
)

found = na.synthesise(
    emulator, system,
    na.Objective.of(
        na.effort(0.003),
        na.smoothness(0.0003),
        na.stay_upright(system, may_pitch=True),  # back up, however steep
        na.reach_height(system, 0.8, within=0.1, at=TOP),  # [m] all of it, tail included
        na.reach_heading(system, [np.cos(STEEP), 0, -np.sin(STEEP)], within=0.13, at=ENTRY),
    ),
    start, steps=steps, refinements=0, corrections=8, first=first,
    parametrisation=Steered.of(steps, emulator.dt, gait.period / TEMPO, 7, bounds),
)  # fmt: skip

print(
    f"{found.descent.iterations} iterations, {found.descent.seconds:.2f} s, {found.physics_steps} physics steps"
)
lowest = read_heights(system.structure, found.outcome.physics_states).min(
    axis=1
)  # of all mass points, at every super step
top = int(lowest.argmax())
entry = min(top + int((lowest[top:] > 0).argmin()), steps)
pose = na.read_pose(system.structure, found.outcome.physics_states)
pitch, roll = np.degrees(np.arcsin(pose.forward[entry, 2])), np.degrees(abs(pose.roll[top]))
print(f"the true dolphin leaps: its lowest point rises {lowest[top]:.2f} m over the water, its middle "
      f"{pose.position[:, 2].max():.2f} m, there rolled by {roll:.0f}°, and it dives in at {pitch:.0f}°")  # fmt: skip
na.write_comparison(emulator, found.outcome, Path("leap.glb"))
