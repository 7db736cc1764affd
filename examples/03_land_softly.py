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
found = na.descend(emulator, objective, start, steps=round(pad.seconds / emulator.dt))
proof = na.replay(emulator, system, objective, start, found.controls)

print(f"{found.iterations} iterations, {found.seconds:.2f} s")
print(f"J on emulator {proof.cost_emulator:.2f}, on MuJoCo {proof.cost_physics:.2f}")
print("landed on MuJoCo:", na.is_reached(system, "pad", proof.physics_states[-1]))
na.write_comparison(emulator, proof, Path("landing.glb"))
