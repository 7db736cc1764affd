"""Load a learned pendulum, swing it up through the emulator, prove it on MuJoCo, and write a GLB."""

from pathlib import Path

import numpy as np

import neuroanimator as na

emulator = na.Emulator.load(na.find_emulator("pendulum-50"))
system, goal, rest = na.load_system("pendulum"), na.stand_upright(), np.zeros(6)

found = na.descend(emulator, goal, rest, steps=30)  # 1.5 s of torques, by gradients through the emulator
proof = na.replay(emulator, system, goal, rest, found.controls)  # the same torques on MuJoCo

print(f"{found.iterations} iterations, {found.seconds:.2f} s")
print(f"J on emulator {proof.cost_emulator:.3f}, on MuJoCo {proof.cost_physics:.3f}")
print("upright on MuJoCo:", na.is_upright(proof.physical[-1]))
na.write_proof(emulator, proof, Path("swing-up.glb"))
