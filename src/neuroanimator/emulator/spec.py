"""The fixed facts an emulator carries about its system: names, units, bounds, rest, skeleton. No weights."""

from __future__ import annotations

from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.pytrees import Module, static
from neuroanimator.state.gait import Gait
from neuroanimator.state.layout import Bounds, Layout


class EmulatorSpec(Module):
    """What an emulator stands for: fixed facts, no weights."""

    system: str = static()
    """Name of the system."""
    state: Layout = static()
    """Named parts and units of a state (S,)."""
    control: Layout = static()
    """Named parts and units of a control (C,)."""
    bounds: Bounds = static()
    """Lowest and highest value of every control."""
    substeps: int = static()
    """Physics steps one super step stands for."""
    dt: float = static()
    """Time one super step covers [s]."""
    skeleton: Skeleton = static()
    """Bones to draw a state with."""
    rates: tuple[tuple[int, int], ...] = static()
    """(i, j) where state entry j is the time derivative of entry i."""
    rest: tuple[float, ...] = static()
    """A state of rest, where motions begin if nothing else is said."""
    definition: str = static(default="")
    """JSON text the system can be made from again; empty for one that comes with the package."""
    gait: Gait | None = static(default=None)
    """How the system moves along if nothing else is said."""
    strides: int = static(default=1)
    """Number of equal strides of the network in a super step: see `Emulator.in_strides`."""
