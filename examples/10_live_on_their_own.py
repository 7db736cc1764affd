"""Let a school of fish live on its own in a tank: each decides where to go, a shipped policy moves its muscles."""

from pathlib import Path

import numpy as np

import neuroanimator as na
from neuroanimator.control.policies.behaviours import Tank, follow, school, stay_inside, wander
from neuroanimator.control.policies.drive import live
from neuroanimator.control.policies.policy import Policy
from neuroanimator.shipped import find_policy

policy = Policy.load(find_policy("fish"))  # speed and direction to twelve muscles, learnt through the emulator
system = na.load_system("fish")
tank = Tank(low=(-1.2, -1.2, -0.7), high=(1.2, 1.2, 0.7))
rng = np.random.default_rng(1)
LEVEL = np.array([1.0, 1.0, 0.3])

count, seconds = 20, 30.0
starts = np.tile(system.rest, (count, 1))
points = slice(0, 3 * 23)  # the state begins with the places of 23 mass points
starts[:, points] += np.tile(rng.uniform(-0.5, 0.5, (count, 3)) * [1, 1, 0.5], 23)


def wish(pose, time):
    """Stroll with the others, mostly level, keep some distance, and stay off the glass."""
    company = wander(pose, time) + school(pose, spacing=0.3, reach=0.6)
    return follow(company * LEVEL + 12 * stay_inside(pose, tank, margin=0.4), speed=0.1)


lives = np.asarray(live(policy, wish, starts, round(seconds / policy.dt)))

nose = system.state.index("nose")
for number in range(3):
    way = np.linalg.norm(np.diff(lives[number, :, nose], axis=0), axis=1).sum()
    print(f"in {seconds:.0f} s the nose of fish {number} has come {way:.1f} m")
    na.write_glb(na.make_clip(policy.emulator, lives[number]), Path(f"fish-{number}.glb"))
