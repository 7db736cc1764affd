"""Gymnasium's Pendulum-v1 as a step function that declares no more than it must."""

import numpy as np

STEP = 0.05
STATE = {"angle": "rad", "velocity": "rad/s"}
CONTROL = {"torque": ("N·m", -2.0, 2.0)}


def step(state, control, dt):
    angle, velocity = state
    torque = np.clip(control[0], -2.0, 2.0)
    velocity = np.clip(velocity + (15.0 * np.sin(angle) + 3.0 * torque) * dt, -8.0, 8.0)
    return np.array([angle + velocity * dt, velocity])
