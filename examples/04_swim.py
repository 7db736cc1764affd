"""Let the fish swim: on the true springs and on its emulator, side by side in numbers, as a skinned GLB."""

from pathlib import Path

import numpy as np

import neuroanimator as na

emulator = na.load_emulator("fish-50")
system = na.load_system("fish")

steps = round(6.0 / emulator.dt)
muscles = system.gait.controls(steps, emulator.dt, system.bounds)  # twelve waves along the body
muscles[steps // 2 :, :4] = 0.6 * np.array(
    [1, -1, -1, 1]
)  # then the front segment bends left: a turn

emulator_states = np.asarray(emulator.rollout(system.rest, muscles))
true = system.simulate(system.rest[None], muscles[None], emulator.dt).states[0]

nose = system.state.index("nose")
for seconds in (1, 3, 6):
    step = round(seconds / emulator.dt)
    way = np.linalg.norm(true[step, nose] - true[0, nose])
    apart = np.linalg.norm(true[step, nose] - emulator_states[step, nose])
    print(
        f"after {seconds} s the nose has come {100 * way:5.1f} cm; the emulated one is {100 * apart:.1f} cm away"
    )

na.write_glb(na.make_clip(emulator, emulator_states), Path("swim.glb"))
