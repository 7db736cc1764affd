"""The true, slow physics."""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import TYPE_CHECKING

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.text import did_you_mean, quoted

if TYPE_CHECKING:  # names do not wait for physics
    from neuroanimator.systems.system import System

SYSTEMS = {name: system.about for name, system in SHIPPED_SYSTEMS.items()}
"""Descriptions of the shipped systems, by name."""


def goal_names(name: str) -> tuple[str, ...]:
    """Return the goals of the shipped system called `name`, without making its physics."""
    file = resources.files("neuroanimator.systems") / "assets" / f"{name}.toml"
    if not file.is_file():
        return SHIPPED_SYSTEMS[name].goals
    return tuple(tomllib.loads(file.read_text()).get("goals", {}))


def load_system(name: str, definition: str = "") -> System:
    """Return the system called `name`, or the one described by your TOML file `name`.

    Naming a TOML file allows this process to run the step function beside it, or to open the recordings: name only
    files whose code you would run. `definition` is the definition of the system in a dataset or an emulator; with it, and
    for every name from a file, see `carried_system`.
    """
    if definition or not name.endswith(".toml"):
        return carried_system(name, definition)
    from neuroanimator.systems import loading

    loading.trust_files(name)
    return loading.from_text(loading.resolve(name)[1])


def carried_system(name: str, definition: str = "") -> System:
    """Return the system that a dataset, an emulator or a policy names: a shipped one, or the one in `definition`.

    No code is run and no recording opened, whatever the file says. Its model is looked for among those this process
    knows, and beside the file. Raises MissingPhysicsError if it is missing, or differs.
    """
    from neuroanimator.systems import loading
    from neuroanimator.systems.rigid import pendulum

    if definition:
        system = loading.from_text(definition)
        if system.name != name:
            raise BadFileError(
                f"The definition is of the system {quoted(system.name)}, not of {quoted(name)}."
            )
        return system
    if name not in SYSTEMS:
        raise ArgumentError(
            f"No system called {quoted(name)}. {did_you_mean(name, SYSTEMS)}Systems: {', '.join(sorted(SYSTEMS))}."
        )
    pendulums = {
        "pendulum": pendulum.active_pendulum,
        "pendulum-passive": pendulum.passive_pendulum,
    }
    return pendulums[name]() if name in pendulums else loading.packaged(name)
