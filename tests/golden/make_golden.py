"""Make the golden files: a small emulator and a small policy, and what they predict.

Run it only when the format changes, together with raising its version (see docs/format.md):
`python tests/golden/make_golden.py`. Released golden files are kept, and stay readable or are refused by their version.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from neuroanimator import DatasetConfig, Emulator, TrainingConfig
from neuroanimator.control.policies.policy import Policy, fresh_policy
from neuroanimator.emulator.artifact import save
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.state.layout import Bounds

FOLDER = Path(__file__).parent
EMULATOR = FOLDER / "pendulum.emulator.safetensors"
POLICY = FOLDER / "fish.policy.safetensors"
PREDICTIONS = FOLDER / "predictions.json"
RANGES = Bounds((0.0, -1.0, -1.0, -1.0), (0.5, 1.0, 1.0, 1.0))
STEPS = 6


def small_emulator(system: str, **settings: Any) -> Emulator:
    """Return an emulator of `system` that fits a few transitions, its network drawn and not trained."""
    data = simulate_transitions(DatasetConfig(system=system, count=120, seed=7), threads=1)
    return build_emulator(data, TrainingConfig(seed=7, **settings))


def emulator_case(emulator: Emulator) -> dict[str, Any]:
    """Return a start, controls and the trajectory under them."""
    rng, spec = np.random.default_rng(1), emulator.spec
    start = np.array(spec.rest) + rng.normal(size=spec.state.size) * 0.1
    controls = spec.bounds.middle + spec.bounds.half * rng.uniform(
        -1, 1, (STEPS, spec.control.size)
    )
    states = np.asarray(emulator.rollout(start, controls), float)
    return {"start": start.tolist(), "controls": controls.tolist(), "states": states.tolist()}


def policy_case(policy: Policy) -> dict[str, Any]:
    """Return states, phases, commands and the controls for them."""
    rng, rest = np.random.default_rng(2), policy.emulator.rest
    states = rest + rng.normal(size=(STEPS, len(rest))) * 0.003
    phases, commands = rng.uniform(0, 6, STEPS), rng.uniform(RANGES.low, RANGES.high, (STEPS, 4))
    controls = controls_of(policy, states, phases, commands)
    inputs = {"states": states.tolist(), "phases": phases.tolist(), "commands": commands.tolist()}
    return {**inputs, "controls": controls.tolist()}


def controls_of(
    policy: Policy, states: np.ndarray, phases: np.ndarray, commands: np.ndarray
) -> np.ndarray:
    """Return the controls (B, C) of `policy` for bodies in `states` (B, S)."""
    latent = jnp.asarray(policy.emulator.encode(np.asarray(states, float)), jnp.float32)
    numbers = [jnp.asarray(each, jnp.float32) for each in (phases, commands)]
    return np.asarray(jax.vmap(policy.control)(latent, *numbers), float)


def main() -> None:
    """Write the files."""
    save(
        small_emulator("pendulum", widths=(6, 4)),
        EMULATOR,
        {"made by": "tests/golden/make_golden.py"},
    )
    fish = small_emulator("fish", widths=(4,), position_modes=3, velocity_modes=3)
    policy = fresh_policy(fish, RANGES, (4,), seed=7)
    policy.save(POLICY, {"made by": "tests/golden/make_golden.py"})
    cases = {
        "emulator": emulator_case(Emulator.load(EMULATOR)),
        "policy": policy_case(Policy.load(POLICY)),
    }
    PREDICTIONS.write_text(json.dumps(cases) + "\n")


if __name__ == "__main__":
    main()
