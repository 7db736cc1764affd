"""Record flights as a dataset of Minari, the format in which offline reinforcement learning exchanges episodes.

pip install "neuroanimator[gym]" "minari[hdf5]"
"""

import os
from pathlib import Path

import gymnasium
import numpy as np

os.environ["MINARI_DATASETS_PATH"] = str(Path("episodes").resolve())  # default: ~/.minari
import minari

TASK = "neuroanimator/lander-land-v0"  # the emulator flies, not the physics
NAME = "neuroanimator/lander-land/random-v0"

env = minari.DataCollector(gymnasium.make(f"neuroanimator.gym:{TASK}"))
low, high = env.action_space.low, env.action_space.high
rng = np.random.default_rng(0)
for episode in range(10):
    env.reset(seed=episode)
    thrusts = rng.uniform(low, high)
    is_over = False
    while not is_over:
        # Thrusts that wander: new ones at every step would cancel out.
        thrusts = np.clip(thrusts + 0.2 * (high - low) * rng.normal(size=low.shape), low, high)
        _, _, terminated, truncated, _ = env.step(thrusts.astype(np.float32))
        is_over = terminated or truncated

env.create_dataset(
    NAME,
    eval_env=TASK,
    algorithm_name="random thrusts",
    description="Flights over the pad under wandering thrusts, by the emulator lander-50.",
    author="my name",
    author_email="me@example.org",
    code_permalink="https://example.org/record_episodes.py",
)

dataset = minari.load_dataset(NAME)  # as anyone with the folder would
returns = [episode.rewards.sum() for episode in dataset]
print(f"{dataset.total_episodes} episodes of {dataset.total_steps} steps in all")
print(f"the best of them earned {max(returns):.2f}, the worst {min(returns):.2f}")
