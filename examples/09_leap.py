"""A dolphin leaps clear of the water and dives in nose first: found by its emulator, proved on the true springs."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control import Steered

DEPTH = 4.2  # [m] depth below its rest at which it starts, for a run-up
SECONDS = 4.2
TEMPO = 1.5  # times the frequency of its gait
TOP = 3.3  # [s] time of its highest point
ENTRY = 3.85  # [s] time at which it dives in again
STEEP = np.radians(50)  # below the horizontal

emulator = na.load_emulator("dolphin-50")
system = na.load_system("dolphin")
steps = round(SECONDS / emulator.dt)
start = np.array(system.rest)
start[2 : 3 * 23 : 3] -= DEPTH

# A pull that is the same left and right cannot twist it in flight: only muscles of the gait may pull.
bounds = na.Bounds.symmetric(np.where(np.array(system.gait.amplitudes) == 0, 1e-3, 1.0))

# A first guess: its gait, but faster, and its back bent upward at first.
gait = system.gait
times = np.arange(steps) * emulator.dt
bend = np.interp(times, [0.0, 0.8, 2.4, SECONDS], [0.0, 0.32, 0.0, -0.09])
strokes = 0.8 * gait.controls(steps, emulator.dt, bounds, tempo=TEMPO)
first = strokes + bend[:, None] * np.sign(gait.amplitudes)

nose_first = [np.cos(STEEP), 0, -np.sin(STEEP)]
objective = na.Objective.of(
    na.effort(0.003),
    na.smoothness(0.0003),
    na.stay_upright(system, may_pitch=True),  # back up, however steep
    na.reach_height(system, 0.8, within=0.1, at=TOP),  # [m] all of it, tail included
    na.reach_heading(system, nose_first, within=0.13, at=ENTRY),
)
parametrisation = Steered.of(steps, emulator.dt, gait.period / TEMPO, 7, bounds)
descent = na.DescentOptions(parametrisation=parametrisation, first=first)
options = na.SearchOptions(descent, corrections=8, refinements=0)
controller = na.synthesise(emulator, system, objective, start, steps=steps, options=options)

spent = controller.spent
print(f"{spent.iterations} iterations, {spent.seconds:.2f} s, {spent.physics_steps} physics steps")
heights = na.read_heights(system.structure, controller.outcome.physics_states)
lowest = heights.min(axis=1)  # of all mass points, at every super step
top = int(lowest.argmax())
entry = min(top + int((lowest[top:] > 0).argmin()), steps)
pose = na.read_pose(system.structure, controller.outcome.physics_states)
pitch = np.degrees(np.arcsin(pose.forward[entry, 2]))
roll = np.degrees(abs(pose.roll[top]))
print(f"the true dolphin leaps: its lowest point rises {lowest[top]:.2f} m over the water, its middle "
      f"{pose.position[:, 2].max():.2f} m, there rolled by {roll:.0f}°, and it dives in at {pitch:.0f}°")  # fmt: skip
na.write_comparison(emulator, controller.outcome, Path("leap.glb"))
