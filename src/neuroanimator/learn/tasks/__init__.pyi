"""Public names and their homes, for type checkers and, at run time, for `neuroanimator.lazy`."""

from neuroanimator.learn.tasks.rigid import FINAL_DESCENT_SECONDS as FINAL_DESCENT_SECONDS
from neuroanimator.learn.tasks.rigid import HOLD_SECONDS as HOLD_SECONDS
from neuroanimator.learn.tasks.rigid import HOLD_STRIDE as HOLD_STRIDE
from neuroanimator.learn.tasks.rigid import PAD_RADIUS as PAD_RADIUS
from neuroanimator.learn.tasks.rigid import RIGID_TASKS as RIGID_TASKS
from neuroanimator.learn.tasks.rigid import TRUCK_AVOIDANCE as TRUCK_AVOIDANCE
from neuroanimator.learn.tasks.rigid import TRUCK_MARGIN as TRUCK_MARGIN
from neuroanimator.learn.tasks.rigid import TRUCK_PROBES as TRUCK_PROBES
from neuroanimator.learn.tasks.rigid import clearance as clearance
from neuroanimator.learn.tasks.rigid import is_soft_landing as is_soft_landing
from neuroanimator.learn.tasks.rigid import landing_objective as landing_objective
from neuroanimator.learn.tasks.rigid import lot_zones as lot_zones
from neuroanimator.learn.tasks.solver import Solver as Solver
from neuroanimator.learn.tasks.swimmers import ROLL_WITHIN as ROLL_WITHIN
from neuroanimator.learn.tasks.swimmers import SWIMMER_TASKS as SWIMMER_TASKS
from neuroanimator.learn.tasks.swimmers import body_length as body_length
from neuroanimator.learn.tasks.swimmers import ends_upright as ends_upright
from neuroanimator.learn.tasks.swimmers import gait_controls as gait_controls
from neuroanimator.learn.tasks.swimmers import steps_of_a_period as steps_of_a_period
from neuroanimator.learn.tasks.task import Aim as Aim
from neuroanimator.learn.tasks.task import Task as Task
from neuroanimator.learn.tasks.task import Trial as Trial
