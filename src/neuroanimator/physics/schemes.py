"""The three schemes in a definition: the user's own, the teacher's, and the reference."""

from __future__ import annotations

from typing import NamedTuple

from neuroanimator.definitions.body import BodyPhysics
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


def schemes_of(physics: Physics | BodyPhysics | SoftPhysics) -> Schemes:
    """Return the schemes in the table `physics` of a definition."""
    if isinstance(physics, SoftPhysics):
        return Schemes(
            scheme=Scheme(SMALL_STEPS, physics.step),
            truth=Scheme(SMALL_STEPS, physics.truth_step),
            fine=Scheme(SMALL_STEPS, physics.fine_step),
        )
    return Schemes(
        scheme=Scheme(physics.integrator, physics.step),
        truth=Scheme(physics.truth_integrator, physics.truth_step),
        fine=Scheme(physics.fine_integrator, physics.fine_step),
    )
