"""Simulate, train and measure an emulator of the passive pendulum. About a minute."""

from pathlib import Path

import neuroanimator as na

folder = Path("passive")
config = na.DatasetConfig(system="pendulum-passive", substeps=50, count=20_000, seed=0)
na.generate(config, folder)
data = na.read_transitions(folder)

emulator = na.train(data, na.TrainingConfig(updates=5_000), folder / "passive.emulator.safetensors")
evaluation = na.evaluate(emulator, data=data, budget=na.EvaluationBudget(starts=100, steps=200))

print(f"one-step error {evaluation.one_step_error:.3f}")
print(
    f"nominal speed-up {evaluation.speed.nominal:.0f}, at equal error {evaluation.speed.equal_error:.1f}"
)
na.write_report([evaluation], folder / "report.html")
