"""Every task by name."""

from __future__ import annotations

from neuroanimator.learn.tasks.rigid import RIGID_TASKS
from neuroanimator.learn.tasks.swimmers import SWIMMER_TASKS

TASKS = {task.name: task for task in (*RIGID_TASKS, *SWIMMER_TASKS)}
