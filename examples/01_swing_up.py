"""Load a learned pendulum, swing it up through the emulator, prove it on MuJoCo, and write a GLB."""

from pathlib import Path

import numpy as np

import neuroanimator as na

emulator = na.Emulator.load("pendulum-50")  # ships with the package; or the file of one you trained
system, goal, rest = na.load_system("pendulum"), na.stand_upright(), np.zeros(6)

# 1.5 s of torques, by gradients through the emulator; what their replay on MuJoCo shows corrects the emulator.
found = na.synthesise(emulator, system, goal, rest, steps=30)
proof = found.outcome

print(
    f"{found.descent.iterations} iterations, {found.descent.seconds:.2f} s, {found.corrections} corrections"
)
print(
    f"J on MuJoCo {proof.cost_physics:.3f}; by the emulator alone, not corrected, {proof.cost_emulator:.3f}"
)
print("upright on MuJoCo:", na.is_upright(proof.physics_states[-1]))
na.write_comparison(emulator, proof, Path("swing-up.glb"))
