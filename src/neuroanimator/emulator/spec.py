"""The facts about its system that an emulator carries: names, units, bounds, rest, skeleton. No weights."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout

MAX_STRIDES = 16
"""Maximum number of strides in a super step: each is compiled one by one."""


MAX_GAIN = 1e12
"""Maximum magnitude of a gain written into a file; larger ones are cut."""

GAINS = ("gain", "stiffness", "damping")
"""The numbers of each actuator in an `Engine`."""


class Engine(NamedTuple):
    """The release of the physics engine, and the gains it compiled, under which a system was trained.

    Another release may read other gains from the same file: a servo's `dampratio` in a chain
    of links damps less since MuJoCo 3.15.
    """

    release: str
    gains: tuple[float, ...] = ()
    """`GAINS` of each actuator, in the model's order."""


class EmulatorSpec(eqx.Module):
    """The fixed facts about an emulator's system; no weights."""

    system: str = eqx.field(static=True)
    """Name of the system."""
    state: Layout = eqx.field(static=True)
    """Named parts and units of a state (S,)."""
    control: Layout = eqx.field(static=True)
    """Named parts and units of a control (C,)."""
    bounds: Bounds = eqx.field(static=True)
    """Minimum and maximum value of every control."""
    substeps: int = eqx.field(static=True)
    """Number of physics steps in a super step."""
    dt: float = eqx.field(static=True)
    """Duration of a super step [s]."""
    skeleton: Skeleton = eqx.field(static=True)
    """Bones that draw a state."""
    rates: tuple[tuple[int, int], ...] = eqx.field(static=True)
    """(i, j) where state entry j is the time derivative of entry i."""
    rest: tuple[float, ...] = eqx.field(static=True)
    """State of rest, the default start of motions."""
    definition: str = eqx.field(static=True, default="")
    """JSON text from which the system can be rebuilt; empty for a system that ships."""
    is_tied: bool = eqx.field(static=True, default=False)
    """Whether parts of the system are tied together, so that not every state is possible: see `System.closed`."""
    engine: Engine | None = eqx.field(static=True, default=None)
    """Engine that it was trained under; None if it is not MuJoCo, or in files of older versions."""
    gait: Gait | None = eqx.field(static=True, default=None)
    """Default gait of the system."""
    strides: int = eqx.field(static=True, default=1)
    """Number of equal strides of the network in a super step: see `Emulator.in_strides`."""
