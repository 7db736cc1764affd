"""The fixed facts an emulator carries about its system: names, units, bounds, rest, skeleton. No weights."""

from __future__ import annotations

import equinox as eqx

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout

MAX_STRIDES = 16
"""Maximum number of strides in a super step: each is compiled one by one."""


class EmulatorSpec(eqx.Module):
    """What an emulator stands for: fixed facts, no weights."""

    system: str = eqx.field(static=True)
    """Name of the system."""
    state: Layout = eqx.field(static=True)
    """Named parts and units of a state (S,)."""
    control: Layout = eqx.field(static=True)
    """Named parts and units of a control (C,)."""
    bounds: Bounds = eqx.field(static=True)
    """Lowest and highest value of every control."""
    substeps: int = eqx.field(static=True)
    """Physics steps one super step stands for."""
    dt: float = eqx.field(static=True)
    """Time one super step covers [s]."""
    skeleton: Skeleton = eqx.field(static=True)
    """Bones to draw a state with."""
    rates: tuple[tuple[int, int], ...] = eqx.field(static=True)
    """(i, j) where state entry j is the time derivative of entry i."""
    rest: tuple[float, ...] = eqx.field(static=True)
    """A state of rest, where motions begin if nothing else is said."""
    definition: str = eqx.field(static=True, default="")
    """JSON text the system can be made from again; empty for one that comes with the package."""
    gait: Gait | None = eqx.field(static=True, default=None)
    """How the system moves along if nothing else is said."""
    strides: int = eqx.field(static=True, default=1)
    """Number of equal strides of the network in a super step: see `Emulator.in_strides`."""
