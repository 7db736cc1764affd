"""TOML tables that several kinds of systems share: parts of states and controls, goals, parameters of a family, water, gaits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_serializer

from neuroanimator.files.names import PartName
from neuroanimator.files.tables import Finite, Positive, Share, Table
from neuroanimator.state.gait import GAIT_SHARE

MAX_SECONDS = 1e6
"""Maximum duration of a motion to a goal [s]: twelve days, for something slow."""

MAX_PARAMETERS = 64
"""Maximum number of parameters of a family."""

MAX_TARGET = 200
"""Maximum number of characters of a parameter's target."""


NotNegative = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
"""A number that may be zero, for the absence of the effect it measures."""


class StatePart(Table):
    """One named part of the state of a system without a model file."""

    name: PartName
    unit: str
    size: int = Field(1, ge=1, le=256)
    """Length of the part, a vector in one unit."""
    feature: Literal["plain", "sine", "cyclic"] = "plain"
    """How the part is represented to the network: as it is, by sine and cosine, or not at all.

    A cyclic part is left out: its position does not matter, only its rate.
    """
    rate: str = ""
    """Name of the part that is its rate of change; empty if there is none."""
    rest: tuple[Finite, ...] = ()
    """Its numbers at rest; zeros if not given."""
    spread: tuple[Annotated[float, Field(ge=0, le=1e9)], ...] = ()
    """Half the width of the uniform spread of random starts around rest."""


class ControlPart(Table):
    """One named part of the control, and its bounds."""

    name: PartName
    unit: str
    low: tuple[Finite, ...] = Field(min_length=1, max_length=256)
    """Minimum value of each of its numbers."""
    high: tuple[Finite, ...] = Field(min_length=1, max_length=256)
    """Maximum value of each of its numbers."""


class GoalTable(Table):
    """A state, or part of one, worth reaching."""

    seconds: Annotated[float, Field(gt=0, le=MAX_SECONDS)] = 2.0
    """Time in which to get there [s]; its maximum depends on the super step."""
    site: str = ""
    """Site of the model whose position and orientation a free root should reach, at rest."""
    reach: dict[str, tuple[Finite, ...]] = Field(default={})
    """Parts of the state and their values at the end."""
    start: dict[str, tuple[Finite, ...]] = Field(default={})
    """Parts of the default start of a motion to this goal; all others are as at rest."""
    within: dict[str, Positive] = Field(default={})
    """Maximum error of each of these parts, in its unit; 0.1 by default."""


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


class WaterTable(Table):
    """Water around the body; `physics.water.Water` explains the keys."""

    face_drag: NotNegative
    drag: NotNegative = 0.0
    buoyancy: Annotated[float, Field(ge=0, le=10)] = 1.0
    surface: Finite | None = None
    depth: Positive = 0.1
    righting: NotNegative = 0.0


class GaitTable(Table):
    """The controls of a typical motion; `state.gait.Gait` explains the keys."""

    period: Positive
    controls: dict[PartName, tuple[Finite, Finite]]
    """Amplitude and lag [rad] of each control; controls not named stay at rest."""
    share: Share = GAIT_SHARE
    """Share of training runs that move by the gait; in the others controls are random."""

    @model_serializer(mode="wrap")
    def _without_usual_share(self, write: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        """Return the values without a share that says nothing: older datasets of the same gait are still its data."""
        values = write(self)
        if self.share == GAIT_SHARE:
            values.pop("share", None)
        return values


class BodySampling(Table):
    """Random starts of training runs, around the state of rest."""

    rest_share: Share = 0.2
    """Share of starts at rest, as most motions begin."""
    warm_up: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Duration of random driving, from which starts are taken [s]."""
    velocity: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    """Standard deviation of the velocity along each of the body's own axes [m/s]."""
    angular_velocity: NotNegative = 0.0
    """Standard deviation of each angular velocity [rad/s]."""
    tilt: Annotated[float, Field(ge=0, le=3.2)] = 0.0
    """Standard deviation of the tilt [rad] under gravity; without gravity a body starts at a random orientation."""
    height: tuple[Finite, Finite] = (0.0, 0.0)
    """Minimum and maximum height of a start above the height at rest [m]."""
    strain: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Standard deviation of a random strain of the whole body along each of its axes."""
