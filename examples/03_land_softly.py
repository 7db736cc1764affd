"""Land the lunar lander on its pad: found through the emulator, proved on MuJoCo, written as GLB."""

from pathlib import Path

import neuroanimator as na

emulator = na.load_emulator("lander-50")
system = na.load_system("lander")
pad = system.goals["pad"]

start = system.rest.copy()
start[:3] += [3.0, -2.0, 6.0]  # 6 m up, off to the side,
start[9] = -0.5  # and sinking at 0.5 m/s

objective = na.Objective.of(na.effort(), na.goal(system, "pad"))
controller = na.descend(emulator, objective, start, steps=round(pad.seconds / emulator.dt))
replayed = na.replay(emulator, system, objective, start, controller.controls)

print(f"{controller.iterations} iterations, {controller.seconds:.2f} s")
print(f"J on emulator {replayed.cost_emulator:.2f}, on MuJoCo {replayed.cost_physics:.2f}")
print("landed on MuJoCo:", na.is_reached(system, "pad", replayed.physics_states[-1]))
na.write_comparison(emulator, replayed, Path("landing.glb"))
