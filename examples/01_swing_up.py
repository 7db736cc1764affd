"""Take the learnt emulator of a motorised pendulum, swing it up through the emulator, prove it on MuJoCo, and write a GLB."""

from pathlib import Path

import neuroanimator as na

emulator = na.load_emulator("pendulum-50")  # ships with the package; or the file of one you trained
system = na.load_system("pendulum")
objective = na.Objective.of(na.effort(), na.goal(system, "upright"))

# 1.5 s of torques, by gradients through the emulator; what their replay on MuJoCo shows corrects the emulator.
controller = na.synthesise(emulator, system, objective, system.rest, steps=30)
outcome = controller.outcome

spent = controller.spent
print(f"{spent.iterations} iterations, {spent.seconds:.2f} s, {spent.corrections} corrections")
print(f"J on MuJoCo {outcome.cost_physics:.3f}")
print(f"J by the emulator alone, not corrected, {outcome.cost_emulator:.3f}")
print("upright on MuJoCo:", na.is_reached(system, "upright", outcome.physics_states[-1]))
na.write_comparison(emulator, outcome, Path("swing-up.glb"))
