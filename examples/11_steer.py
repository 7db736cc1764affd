"""Steer a fish as a game would: a shipped policy turns speed and turn rate into muscles, at any frame rate."""

from pathlib import Path

import numpy as np

import neuroanimator as na

pilot = na.Pilot("fish")
frames = [pilot.reset()]
for picture in range(600):  # ten seconds at 60 pictures a second
    orientation = (
        0.5 if 180 <= picture < 360 else 0.0
    )  # [rad/s] to the left, from the third second to the sixth
    frames.append(pilot.step(speed=0.9 * pilot.top_speed, turn=orientation, dt=1 / 60))

for second in (3, 6, 10):
    pose = frames[60 * second].pose
    heading, roll = np.degrees(np.arctan2(pose.forward[1], pose.forward[0])), np.degrees(pose.roll)
    print(
        f"after {second} s: heading {heading:.0f}°, rolled by {roll:.0f}°, {100 * pose.position[0]:.0f} cm along x"
    )
na.write_glb(pilot.clip(frames), Path("steered.glb"))
