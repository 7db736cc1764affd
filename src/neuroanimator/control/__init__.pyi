"""Public names and their homes, for type checkers and, at run time, for `neuroanimator.lazy`."""

from neuroanimator.control.descent.defects import find_defects as find_defects
from neuroanimator.control.descent.descend import Descent as Descent
from neuroanimator.control.descent.descend import evaluator_of as evaluator_of
from neuroanimator.control.descent.descend import first_guesses as first_guesses
from neuroanimator.control.descent.descend import pose_problem as pose_problem
from neuroanimator.control.descent.evaluator import Evaluator as Evaluator
from neuroanimator.control.descent.gradient_check import GradientTrust as GradientTrust
from neuroanimator.control.descent.gradient_check import gradient_trust as gradient_trust
from neuroanimator.control.descent.options import DescentOptions as DescentOptions
from neuroanimator.control.descent.parametrisation import EachStep as EachStep
from neuroanimator.control.descent.parametrisation import Parametrisation as Parametrisation
from neuroanimator.control.descent.parametrisation import Periodic as Periodic
from neuroanimator.control.descent.parametrisation import Spline as Spline
from neuroanimator.control.descent.parametrisation import Steered as Steered
from neuroanimator.control.descent.problem import Problem as Problem
from neuroanimator.control.objective.goals import (
    errors_over_tolerances as errors_over_tolerances,
)
from neuroanimator.control.objective.goals import find_goal as find_goal
from neuroanimator.control.objective.goals import goal_start as goal_start
from neuroanimator.control.objective.goals import goal_state as goal_state
from neuroanimator.control.objective.goals import judged_parts as judged_parts
from neuroanimator.control.objective.objective import Trajectory as Trajectory
from neuroanimator.control.objective.obstacles import Zone as Zone
from neuroanimator.control.synthesis.attempt import SearchCost as SearchCost
from neuroanimator.control.synthesis.objective_file import read_objective as read_objective
from neuroanimator.control.synthesis.objective_file import synthesise_file as synthesise_file
from neuroanimator.control.synthesis.replay import Replay as Replay
from neuroanimator.control.synthesis.synthesise import synthesise_goal as synthesise_goal
from neuroanimator.learn.planning.environments import DmEnvironment as DmEnvironment
from neuroanimator.learn.planning.environments import Environment as Environment
from neuroanimator.learn.planning.environments import Episode as Episode
from neuroanimator.learn.planning.environments import control_environment as control_environment
from neuroanimator.learn.planning.environments import mujoco_state as mujoco_state
from neuroanimator.learn.planning.estimator import ParameterEstimator as ParameterEstimator
from neuroanimator.learn.planning.learn import learn_from as learn_from
from neuroanimator.learn.planning.planner import Plan as Plan
from neuroanimator.learn.planning.planner import Planner as Planner
from neuroanimator.learn.planning.planner import moved_on as moved_on
from neuroanimator.learn.planning.plants import ControlledMotion as ControlledMotion
from neuroanimator.learn.planning.plants import control_plant as control_plant
from neuroanimator.learn.planning.pursue import Pursuit as Pursuit
from neuroanimator.learn.planning.pursue import pursue_goal as pursue_goal
from neuroanimator.systems.goal import Goal as Goal
from neuroanimator.systems.plants import EmulatorPlant as EmulatorPlant
from neuroanimator.systems.plants import PhysicsPlant as PhysicsPlant
