"""Park the truck: found through the emulator in a second, proved on MuJoCo, the emulated motion as a ghost."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control import Spline
from neuroanimator.learn.tasks import TRUCK_MARGIN, TRUCK_PROBES, clearance, lot_zones

emulator = na.load_emulator("truck-100")
system = na.load_system("truck")
steps = round(12.0 / emulator.dt)

start = np.array(system.rest)
start[:2] = [4.0, -1.0]  # in the aisle, facing east; the bay wants it backed in, nose to the south

zones = lot_zones(system)
objective = na.Objective.of(
    na.effort(0.02),
    na.smoothness(0.02),
    na.goal(system, "bay_2"),
    na.avoid(system, zones, probes=TRUCK_PROBES, margin=TRUCK_MARGIN, weight=300.0),
)
controller = na.synthesise(
    emulator,
    system,
    objective,
    start,
    steps=steps,
    options=na.SearchOptions(
        na.DescentOptions(starts=8, parametrisation=Spline.of(steps, 16, system.bounds))
    ),
)

motion = controller.outcome
spent = controller.spent
print(f"{spent.iterations} iterations, {spent.seconds:.2f} s, {spent.physics_steps} physics steps")
print(f"J on emulator {motion.cost_emulator:.2f}, on MuJoCo {motion.cost_physics:.2f}")
print("parked on MuJoCo:", na.is_reached(system, "bay_2", motion.physics_states[-1]))
print(f"nearest to an obstacle: {clearance(system, zones, motion.physics_states):.2f} m")
na.write_comparison(emulator, controller.outcome, Path("park.glb"))
