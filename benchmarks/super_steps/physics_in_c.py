"""The physics of swimmers in C, beside their emulators: the same time, in physics steps of their own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.super_steps.case import BATCHES, SUPER_STEP, Case, Motion, batch_task
from neuroanimator.physics import load_system
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.deformable.native.compiled import SINGLE_LANES, c_twin

NAME = "physics in C"

SYSTEMS = ("fish", "dolphin")


def cases(motion: Motion) -> Iterator[Case]:
    """Yield one body, and sixteen bodies to a register in the largest batch; each takes the physics steps of a super step."""
    emulator = motion.emulator
    if emulator.system not in SYSTEMS:
        return
    system = load_system(emulator.system)
    assert isinstance(system, DeformableSystem)
    integrator = system.scheme.integrator
    largest = BATCHES[-1]
    for lanes, count, task in ((1, 1, SUPER_STEP), (SINGLE_LANES, largest, batch_task(largest))):
        twin = c_twin(system.body, np.float32, lanes)
        if twin is None:
            return
        starts, controls = motion.batch(count)
        steps = emulator.substeps
        run = twin.player(starts, controls[:, 0], integrator, system.physics_dt, steps)
        yield Case(f"{NAME}, {integrator}", task, count, run)
