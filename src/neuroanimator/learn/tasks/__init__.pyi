"""Public names and their homes, for type checkers and, at run time, for `neuroanimator.lazy`."""

from neuroanimator.learn.tasks.rigid import RIGID_TASKS as RIGID_TASKS
from neuroanimator.learn.tasks.rigid import TRUCK_MARGIN as TRUCK_MARGIN
from neuroanimator.learn.tasks.rigid import TRUCK_PROBES as TRUCK_PROBES
from neuroanimator.learn.tasks.rigid import clearance as clearance
from neuroanimator.learn.tasks.rigid import lot_zones as lot_zones
from neuroanimator.learn.tasks.solver import Solver as Solver
from neuroanimator.learn.tasks.swimmers import SWIMMER_TASKS as SWIMMER_TASKS
from neuroanimator.learn.tasks.task import Aim as Aim
from neuroanimator.learn.tasks.task import Task as Task
from neuroanimator.learn.tasks.task import Trial as Trial
