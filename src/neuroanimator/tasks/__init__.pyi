"""Public names and their homes, for type checkers and, at run time, for `neuroanimator.lazy`."""

from neuroanimator.tasks.rigid import RIGID_TASKS as RIGID_TASKS
from neuroanimator.tasks.rigid import TRUCK_MARGIN as TRUCK_MARGIN
from neuroanimator.tasks.rigid import TRUCK_PROBES as TRUCK_PROBES
from neuroanimator.tasks.rigid import clearance as clearance
from neuroanimator.tasks.rigid import lot_zones as lot_zones
from neuroanimator.tasks.solver import Solver as Solver
from neuroanimator.tasks.swimmers import SWIMMER_TASKS as SWIMMER_TASKS
from neuroanimator.tasks.task import Aim as Aim
from neuroanimator.tasks.task import Task as Task
from neuroanimator.tasks.task import Trial as Trial
