"""The true, slow physics."""

from __future__ import annotations

from neuroanimator.errors import ArgumentError
from neuroanimator.systems.system import System

SYSTEMS = {
    "cube": "an elastic cube: 8 mass points, 28 springs, pushed about on hard ground",
    "dolphin": "a dolphin: 23 mass points, 91 springs, 6 muscle actuators; swims and leaps",
    "fish": "a fish: 23 mass points, 91 springs, 12 muscles",
    "lander": "a lunar lander: one main thruster, three attitude jets, four feet",
    "pendulum": "three links, a torque motor at each joint",
    "pendulum-passive": "three links, no motors, pushed by outside forces",
    "truck": "an off-road truck on a parking lot: rear-wheel drive, steered front wheels",
}

GOALS = {
    "lander": "pad (stand on the home pad)",
    "pendulum": "upright",
    "truck": "bay_1 to bay_6 (stand in a parking bay)",
}
"""Named goals of each system that has some."""


def load_system(name: str, definition: str = "") -> System:
    """Return the system called `name`, of the TOML file `name`, or the one `definition` describes.

    `definition` is what a dataset or an emulator of a user's own system carries along.
    """
    from neuroanimator.systems import own, pendulum

    if name.endswith(".toml"):
        definition = own.resolve(name)[1]
    if definition:
        return own.from_text(definition)
    if name not in SYSTEMS:
        raise ArgumentError(f"No system called '{name}'. Systems: {', '.join(sorted(SYSTEMS))}.")
    pendulums = {"pendulum": pendulum.active_pendulum, "pendulum-passive": pendulum.passive_pendulum}
    return pendulums[name]() if name in pendulums else own.packaged(name)
