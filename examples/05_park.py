"""Park the truck: found through the emulator in a second, proved on MuJoCo, the emulated motion as a ghost."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control.descent.parametrisation import Spline
from neuroanimator.tasks.rigid import TRUCK_MARGIN, TRUCK_PROBES, clearance, lot_zones

emulator = na.Emulator.load(na.find_emulator("truck-100"))
system = na.load_system("truck")
steps = round(12.0 / emulator.dt)

start = np.array(system.rest)
start[:2] = [4.0, -1.0]  # in the aisle, facing east; the bay wants it backed in, nose to the south

zones = lot_zones(system)
objective = na.Objective.of(
    na.effort(0.02),
    na.smoothness(0.02),
    na.reach_goal(system.structure, system.rest, system.goals["bay_2"]),
    na.avoid(system, zones, probes=TRUCK_PROBES, margin=TRUCK_MARGIN, weight=300.0),
)
found = na.synthesise(
    emulator,
    system,
    objective,
    start,
    steps=steps,
    starts=8,
    parametrisation=Spline.of(steps, 16, system.bounds),
)

motion = found.outcome
print(
    f"{found.descent.iterations} iterations, {found.descent.seconds:.2f} s, {found.physics_steps} physics steps"
)
print(f"J on emulator {motion.cost_emulator:.2f}, on MuJoCo {motion.cost_physics:.2f}")
print("parked on MuJoCo:", na.is_reached(system, system.goals["bay_2"], motion.physics_states[-1]))
print(f"nearest to an obstacle: {clearance(system, zones, motion.physics_states):.2f} m")
na.write_comparison(emulator, found.outcome, Path("park.glb"))
