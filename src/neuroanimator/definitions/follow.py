"""The TOML table of the recorded motion that a policy is to follow."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field, model_validator

from neuroanimator.files.names import PartName, check_file_name
from neuroanimator.files.tables import Table

ClipName = Annotated[str, AfterValidator(check_file_name)]
"""Name of a file beside its definition."""

Distance = Annotated[float, Field(gt=0, le=1e3)]

Speed = Annotated[float, Field(ge=0, le=100)]

TurningRate = Annotated[float, Field(ge=-20, le=20)]


class CommandsTable(Table):
    """Walking on command: the body moves as the motion does, at a commanded speed and in the direction of a commanded heading.

    The clock turns at the commanded rate, and so does a second hinge beside the body, whose angle is the heading. Below the
    motion's own speed strides are shorter, too; at 0 m/s the body stands as the model does at rest. Above, it may run.
    """

    heading: PartName = "heading"
    """Hinge whose angle is the commanded heading [rad] and whose rate the commanded turning rate."""
    speed: tuple[Speed, Speed]
    """Minimum and maximum commanded speed [m/s]."""
    turning: tuple[TurningRate, TurningRate]
    """Minimum and maximum commanded turning rate, to the left [rad/s]."""
    interval: Annotated[float, Field(gt=0, le=1e4)] = 3.0
    """Mean time between two commands while a policy learns [s]."""
    faster: ClipName | None = None
    """File of a faster gait, such as a run; between its speed and the motion's, strides mix both."""

    @model_validator(mode="after")
    def _check_ranges(self) -> CommandsTable:
        for name in ("speed", "turning"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: wanted the least first, got {low:g}, {high:g}")
        return self


class PushesTable(Table):
    """Pushes of the trunk in random horizontal directions, while a policy learns."""

    impulse: Annotated[float, Field(gt=0, le=1e6)]
    """Largest impulse [N s]."""
    interval: Annotated[float, Field(gt=0, le=1e4)] = 5.0
    """Mean time between two pushes [s]."""


class FollowTable(Table):
    """Following a recorded motion, by servos with target angles near those of the motion.

    The body's first joint is free, and a hinge beside the body is the clock: it turns once in the motion.
    """

    clip: ClipName
    """File of the motion: a table of states, one per control."""
    hold: Annotated[int, Field(ge=1, le=1000)]
    """Number of physics steps for which a control is held."""
    laps: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of laps, each going on where the last one ended; more than 1 for a motion whose last pose is its first."""
    phase: PartName = "phase"
    """Hinge that serves as the clock."""
    trunk: PartName
    """Body whose tilt decides whether the motion is lost."""
    reach: Annotated[float, Field(gt=0, le=4)] = 0.5
    """Maximum difference between the servos' target angles and the motion's next pose [rad]."""
    lost_distance: Distance = 0.25
    """Distance of the root from the motion's beyond which the motion is lost and the episode ends [m]."""
    lost_tilt: Annotated[float, Field(gt=0, le=3.2)] = 0.8
    """Angle between the trunk and the motion's beyond which the motion is lost [rad]."""
    reset_noise: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Maximum random deviation of every joint's angle from the motion at the start of an episode [rad]."""
    feet: Annotated[tuple[PartName, ...], Field(max_length=100)] = ()
    """Bodies to be lifted, set down and tilted as in the motion, without sliding; those not listed count as any other part."""
    pushes: PushesTable | None = None
    """Random pushes; None for none."""
    commands: CommandsTable | None = None
    """Commanded speed and turning; if None, the body follows the motion's own path."""
