"""Public names and their homes, for type checkers and, at run time, for `neuroanimator.lazy`."""

from neuroanimator.control.tasks.rigid import RIGID_TASKS as RIGID_TASKS
from neuroanimator.control.tasks.rigid import TRUCK_MARGIN as TRUCK_MARGIN
from neuroanimator.control.tasks.rigid import TRUCK_PROBES as TRUCK_PROBES
from neuroanimator.control.tasks.rigid import clearance as clearance
from neuroanimator.control.tasks.rigid import lot_zones as lot_zones
from neuroanimator.control.tasks.solver import Solver as Solver
from neuroanimator.control.tasks.swimmers import SWIMMER_TASKS as SWIMMER_TASKS
from neuroanimator.control.tasks.task import Aim as Aim
from neuroanimator.control.tasks.task import Task as Task
from neuroanimator.control.tasks.task import Trial as Trial
