"""Public names and their homes, for type checkers and, at run time, for `neuroanimator.lazy`."""

from neuroanimator.control.policies.behaviours import Tank as Tank
from neuroanimator.control.policies.behaviours import give_way as give_way
from neuroanimator.control.policies.behaviours import keep_apart as keep_apart
from neuroanimator.control.policies.behaviours import limit_angles as limit_angles
from neuroanimator.control.policies.behaviours import prioritise as prioritise
from neuroanimator.control.policies.behaviours import pursue as pursue
from neuroanimator.control.policies.behaviours import school as school
from neuroanimator.control.policies.behaviours import shoal as shoal
from neuroanimator.control.policies.behaviours import stay_inside as stay_inside
from neuroanimator.control.policies.behaviours import steer_along as steer_along
from neuroanimator.control.policies.behaviours import wander as wander
from neuroanimator.control.policies.closed_loop import rollout_on_emulator as rollout_on_emulator
from neuroanimator.control.policies.closed_loop import rollout_on_physics as rollout_on_physics
from neuroanimator.control.policies.pilot import Pilot as Pilot
from neuroanimator.control.policies.pilot import PilotFrame as PilotFrame
from neuroanimator.control.policies.policy import Policy as Policy
from neuroanimator.control.policies.policy import load_policy as load_policy
from neuroanimator.control.policies.state_policy import StatePolicy as StatePolicy
from neuroanimator.control.policies.steering import SteeringTarget as SteeringTarget
from neuroanimator.control.policies.steering import steer_down as steer_down
from neuroanimator.control.policies.steering import steer_forward as steer_forward
from neuroanimator.control.policies.steering import steer_left as steer_left
from neuroanimator.gym.policy_seeds import train_policies as train_policies
from neuroanimator.gym.policy_training import PolicyTraining as PolicyTraining
from neuroanimator.gym.policy_training import train_policy as train_policy
