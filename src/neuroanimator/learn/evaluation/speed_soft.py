"""The opponent of an emulator of a soft body: its physics, in C or MuJoCo's, one body on one core."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from neuroanimator.learn.evaluation.held_out import HeldOut
from neuroanimator.physics.soft.flex_scene import FlexScene
from neuroanimator.physics.soft.scene import Scene
from neuroanimator.physics.soft.soft_scene import Motion
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.systems.system import Scheme

SOFT_NAMES = {Scene.integrator: "C", FlexScene.integrator: "MuJoCo"}
"""Names in reports of the body's physics, by its integrator."""

SOFT_FRAMES = 4
"""Number of super steps in one timed run: each takes milliseconds for a body of thousands of nodes."""

SOFT_DIVISIONS = (2, 4, 5, 8, 10, 16, 20, 25, 40, 50, 80)
"""Numbers of small steps in a super step that are tried."""


def soft_player(system: SoftSystem, test: HeldOut) -> Callable[[], None]:
    """Return a function that takes `SOFT_FRAMES` super steps of the system's own small steps from an unseen state."""
    starts, controls = test.moments(1)
    start = system.motion(starts)
    motion = Motion(start.positions[..., 0], start.velocities[..., 0], start.origin[..., 0])
    ends = np.arange(SOFT_FRAMES + 1)[:, None] * test.dt * controls
    paths = starts[:, : system.control.size] + ends
    steps = system.scheme.steps(test.dt)

    def play() -> None:
        system.scene.play(motion, paths, test.dt, steps)

    return play


def soft_schemes(system: SoftSystem, dt: float) -> set[Scheme]:
    """Return the ways to step the body through `dt` [s]; the reference is among them, as it has no error."""
    schemes = {Scheme(system.scheme.integrator, dt / parts) for parts in SOFT_DIVISIONS}
    return schemes | {system.scheme, system.truth, system.fine}
