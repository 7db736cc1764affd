"""The TOML table that makes a system a family: what varies between bodies, and in which range.

[parameters]
forearm_mass = { sets = "body/forearm/mass", range = [0.25, 0.6] }
elbow_friction = { sets = "joint/elbow/damping", range = [0.01, 0.1] }
"""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field, field_validator

from neuroanimator.files.names import PartName
from neuroanimator.files.tables import Finite, Table

MAX_PARAMETERS = 64
"""Maximum number of parameters of a family."""

MAX_TARGET = 200
"""Maximum number of characters of a parameter's target."""


class ParameterTable(Table):
    """One parameter: its target, and the range in which bodies of the family differ."""

    sets: Annotated[str, Field(min_length=1, max_length=MAX_TARGET)]
    """Attribute of an element of the model, such as `body/forearm/mass`; or the name of a step function's argument."""
    range: tuple[Finite, Finite]
    """Minimum and maximum value."""
    nominal: Finite | None = None
    """Default value; if left out, the model's own, or the middle of the range."""
    unit: str = ""
    """Unit of a step function's argument; the units of a model's attributes are known."""

    @field_validator("range")
    @classmethod
    def _rises(cls, ends: tuple[float, float]) -> tuple[float, float]:
        if not ends[0] < ends[1]:
            raise ValueError("wanted a least value below the largest")
        return ends


def _in_order(tables: dict[str, ParameterTable]) -> dict[str, ParameterTable]:
    return dict(sorted(tables.items()))


Parameters = Annotated[
    dict[PartName, ParameterTable], Field(max_length=MAX_PARAMETERS), AfterValidator(_in_order)
]
"""Table of parameters by name; in a state they are sorted by name."""
