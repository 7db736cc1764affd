"""Simulate, train and measure an emulator of the passive pendulum. Half a minute."""

from pathlib import Path

import neuroanimator as na

folder = Path("passive")
config = na.DatasetConfig(system="pendulum-passive", substeps=50, count=10_000, seed=0)
na.generate(config, folder)
data = na.read_transitions(folder)

emulator = na.train(data, na.TrainingConfig(updates=2_000), folder / "passive.emulator.safetensors")
budget = na.EvaluationBudget(runs=8, repeats=3, starts=100, steps=200)
evaluation = na.evaluate(emulator, data=data, budget=budget)

print(f"one-step error {evaluation.one_step_error:.3f}")
print(
    f"nominal speed-up {evaluation.speed.nominal:.0f}, at equal error {evaluation.speed.equal_error:.1f}"
)
na.write_report([evaluation], folder / "report.html")
