"""The true, slow physics."""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import TYPE_CHECKING

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.text import did_you_mean, quoted

if TYPE_CHECKING:  # whoever asks for names waits for no physics
    from neuroanimator.systems.system import System

SYSTEMS = {name: system.about for name, system in SHIPPED_SYSTEMS.items()}
"""What each system of the package is, by its name."""


def goal_names(name: str) -> tuple[str, ...]:
    """Return the goals of the packaged system called `name`; no physics is made for it."""
    file = resources.files("neuroanimator.systems") / "assets" / f"{name}.toml"
    if not file.is_file():
        return SHIPPED_SYSTEMS[name].goals
    return tuple(tomllib.loads(file.read_text()).get("goals", {}))


def load_system(name: str, definition: str = "") -> System:
    """Return the system called `name`, or the one the TOML file `name` of yours describes.

    Naming a TOML file allows this process to run the step function beside it, or to open the recordings: name only
    files whose code you would run. `definition` is what a dataset or an emulator says of its system; with it, and for
    every name out of a file, see `carried_system`.
    """
    if definition or not name.endswith(".toml"):
        return carried_system(name, definition)
    from neuroanimator.systems import loading

    loading.trust_files(name)
    return loading.from_text(loading.resolve(name)[1])


def carried_system(name: str, definition: str = "") -> System:
    """Return the system a dataset, an emulator or a policy names: a packaged one, or what `definition` describes.

    Whatever the file says, no code is run and no recording opened. Its model is looked for among those this process
    knows, and beside the file. Raises MissingPhysicsError if it is not there, or differs.
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
