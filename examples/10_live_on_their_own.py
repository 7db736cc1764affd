"""Let a school of fish live on its own in a tank: each decides where to go, a shipped policy moves its muscles."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control.policies import Tank, rollout_on_emulator, shoal

policy = na.load_policy(
    "fish"
)  # speed and direction to twelve muscles, learnt through the emulator
system = na.load_system("fish")
tank = Tank(low=(-1.2, -1.2, -0.7), high=(1.2, 1.2, 0.7))
LENGTH = 0.26  # [m] of a fish

seconds = 30.0
corners = np.mgrid[-0.6:0.61:0.4, -0.4:0.41:0.4, 0:1].reshape(3, -1).T  # twelve fish, 40 cm apart
starts = np.tile(system.rest, (len(corners), 1))
points = slice(0, 3 * 23)  # the state begins with the positions of 23 mass points
starts[:, points] += np.tile(corners, 23)

# Stroll with the others, mostly level, run into nobody, and stay off the glass.
behaviour = shoal(tank, length=LENGTH, speed=0.9 * policy.ranges.high[0])
lives = np.asarray(rollout_on_emulator(policy, behaviour, starts, round(seconds / policy.dt)))

pose = policy.pose(np.asarray(policy.emulator.encode(lives.astype(float))))
apart = (
    np.linalg.norm(pose.position[:, None] - pose.position[None], axis=-1)
    + 9 * np.eye(len(lives))[:, :, None]
)
pitch = np.degrees(np.arcsin(np.abs(pose.forward[..., 2])))
print(f"in {seconds:.0f} s no two fish come nearer than {apart.min() / LENGTH:.2f} lengths; none pitches by more than "
      f"{pitch.max():.0f}°")  # fmt: skip
for number in range(3):
    way = np.linalg.norm(np.diff(pose.position[number], axis=0), axis=1).sum()
    print(f"fish {number} has come {way:.1f} m, {way / LENGTH / seconds:.2f} lengths a second")
    na.write_glb(na.make_clip(policy.emulator, lives[number]), Path(f"fish-{number}.glb"))
