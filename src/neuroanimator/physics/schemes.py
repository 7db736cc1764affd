"""The three schemes in a definition: the user's own, the teacher's, and the reference."""

from __future__ import annotations

from typing import NamedTuple

from neuroanimator.definitions.body import BodyPhysics
from neuroanimator.definitions.function import FunctionPhysics
from neuroanimator.definitions.model import Physics
from neuroanimator.definitions.soft import SoftPhysics
from neuroanimator.systems.system import Scheme


class Schemes(NamedTuple):
    """The schemes of a system: see the fields of these names of `System`."""

    scheme: Scheme
    truth: Scheme
    fine: Scheme


SMALL_STEPS = "small steps"
"""Name of the integrator of a soft body whose definition names none."""


def schemes_of(
    physics: Physics | BodyPhysics | SoftPhysics | FunctionPhysics, integrator: str = SMALL_STEPS
) -> Schemes:
    """Return the schemes in the table `physics` of a definition; `integrator` is that of tables that name none."""
    names = (integrator, integrator, integrator)
    if isinstance(physics, Physics | BodyPhysics):
        names = (physics.integrator, physics.truth_integrator, physics.fine_integrator)
    steps = (physics.step, physics.truth_step, physics.fine_step)
    return Schemes(*map(Scheme, names, steps))
