"""Tasks controllers are measured by: random starts, what is wanted, and when the physics has done it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from neuroanimator.lazy import lazy_names

if TYPE_CHECKING:
    from neuroanimator.tasks.rigid import (
        RIGID_TASKS,
        TRUCK_MARGIN,
        TRUCK_PROBES,
        clearance,
        lot_zones,
    )
    from neuroanimator.tasks.solver import Solver
    from neuroanimator.tasks.swimmers import SWIMMER_TASKS
    from neuroanimator.tasks.task import Aim, Task, Trial

_HOMES = {
    "Task": "task",
    "Trial": "task",
    "Aim": "task",
    "RIGID_TASKS": "rigid",
    "SWIMMER_TASKS": "swimmers",
    "Solver": "solver",
    "TRUCK_MARGIN": "rigid",
    "TRUCK_PROBES": "rigid",
    "lot_zones": "rigid",
    "clearance": "rigid",
}

__all__ = [  # noqa: RUF022 (by what they are for)
    # Tasks.
    "Task",
    "Trial",
    "Aim",
    "RIGID_TASKS",
    "SWIMMER_TASKS",
    "Solver",
    # The truck's parking lot.
    "TRUCK_MARGIN",
    "TRUCK_PROBES",
    "lot_zones",
    "clearance",
]

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
