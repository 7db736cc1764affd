"""The true, slow physics."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.text import did_you_mean, quoted

if TYPE_CHECKING:  # names do not wait for physics
    from neuroanimator.emulator.spec import EmulatorSpec
    from neuroanimator.systems.system import System

SYSTEMS_KEPT = 4
"""Number of systems with tied parts that are kept, as each reset of an environment needs one."""


def load_system(name: str, definition: str = "") -> System:
    """Return the system called `name`, or the one described by your TOML file `name`.

    Naming a TOML file allows this process to run the step function beside it, or to open the recordings: name only
    files whose code you would run. `definition` is the definition of the system in a dataset or an emulator; with it, and
    for every name from a file, see `carried_system`.
    """
    if definition or not name.endswith(".toml"):
        return carried_system(name, definition)
    from neuroanimator.physics import loading

    loading.trust_files(name)
    return loading.from_text(loading.resolve(name)[1])


def carried_system(name: str, definition: str = "") -> System:
    """Return the system that a dataset, an emulator or a policy names: a shipped one, or the one in `definition`.

    No code is run and no recording opened, whatever the file says. Its model is looked for among those this process
    knows, and beside the file. Raises MissingPhysicsError if it is missing, or differs.
    """
    from neuroanimator.physics import loading
    from neuroanimator.physics.rigid import pendulum

    if definition:
        system = loading.from_text(definition)
        if system.name != name:
            raise BadFileError(
                f"The definition is of the system {quoted(system.name)}, not of {quoted(name)}."
            )
        return system
    if name not in SHIPPED_SYSTEMS:
        names = sorted(SHIPPED_SYSTEMS)
        raise ArgumentError(
            f"No system called {quoted(name)}. {did_you_mean(name, names)}Systems: {', '.join(names)}."
        )
    pendulums = {
        "pendulum": pendulum.active_pendulum,
        "pendulum-passive": pendulum.passive_pendulum,
    }
    return pendulums[name]() if name in pendulums else loading.packaged(name)


# A missing system is looked for again the next time.
_kept_system = lru_cache(SYSTEMS_KEPT)(carried_system)


def tied_system(spec: EmulatorSpec) -> System | None:
    """Return the system of an emulator, if it ties its parts together; None if it does not, or if its model is missing."""
    if not spec.is_tied:
        return None
    try:
        return _kept_system(spec.system, spec.definition)
    except (BadFileError, ImportError):
        return None
