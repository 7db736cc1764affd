"""The true, slow physics."""

from __future__ import annotations

from neuroanimator.errors import ArgumentError
from neuroanimator.systems.system import System

SYSTEMS = {
    "pendulum": "three links, a torque motor at each joint",
    "pendulum-passive": "three links, no motors, pushed by outside forces",
}


def load_system(name: str) -> System:
    """Return the system called `name`."""
    from neuroanimator.systems import pendulum

    makers = {"pendulum": pendulum.active_pendulum, "pendulum-passive": pendulum.passive_pendulum}
    if name not in makers:
        raise ArgumentError(f"No system called '{name}'. Systems: {', '.join(sorted(SYSTEMS))}.")
    return makers[name]()
