"""The emulators and policies that come with the package."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from neuroanimator.errors import BadFileError

SHIPPED = [
    (system, substeps)
    for system in ("dolphin", "fish", "lander", "pendulum", "pendulum-passive", "truck")
    for substeps in (50, 100, 25)
]
"""(system, substeps) of each in its usual size."""

WITHOUT_EMULATOR = ("cube",)
"""Systems no emulator ships of: their physics costs less than one as exact (docs/decisions/0017-strides.md)."""

LARGE = [
    (system, 50)
    for system in ("dolphin", "fish", "lander", "pendulum", "pendulum-passive", "truck")
]
"""(system, substeps) of those that ship in a large size too: slower and more exact."""


def shipped_path(system: str, substeps: int = 50, size: str = "") -> Path:
    """Return where the shipped emulator of `system` at `substeps` lies; `size` is "large", or empty for the usual one."""
    name = emulator_name(system, substeps, size)
    return (
        Path(str(resources.files("neuroanimator"))) / "emulators" / f"{name}.emulator.safetensors"
    )


def emulator_name(system: str, substeps: int, size: str = "") -> str:
    """Return the name an emulator ships under: `pendulum-50` or `pendulum-50-large`."""
    name = f"{system}-{substeps}"
    return f"{name}-{size}" if size else name


def default_motion_path(system: str) -> Path:
    """Return where the motion lies that a shipped `system` is shown with (benchmarks/default_motions.py)."""
    return shipped_path(system).with_name(f"{system}.motion.json")


def shipped_emulators() -> dict[str, Path]:
    """Return where every emulator that ships lies, by its name."""
    usual = {emulator_name(*row): shipped_path(*row) for row in SHIPPED}
    large = {emulator_name(*row, "large"): shipped_path(*row, "large") for row in LARGE}
    return usual | large


def is_name(reference: str) -> bool:
    """Return whether `reference` may name something that ships: it has no folder and no suffix."""
    return Path(reference).name == reference and not Path(reference).suffix


def find_emulator(name: str) -> Path:
    """Return the file `name` is, or the shipped emulator it names: `pendulum`, `pendulum-100` or `pendulum-50-large`."""
    path = Path(name)
    if path.is_file():
        return path
    shipped = shipped_emulators()
    usual = {system: shipped_path(system) for system, _ in SHIPPED}
    found = (shipped | usual).get(name)
    if found is not None and found.is_file():
        return found
    for system in WITHOUT_EMULATOR:
        if name == system or name.startswith(f"{system}-"):
            raise BadFileError(
                f"No emulator file '{name}', and no emulator of {system} ships: its physics costs less. "
                f"Make one with 'neuroanimator train {system} --out {system}.emulator.safetensors' and name that file."
            )
    names = ", ".join(sorted(shipped))
    raise BadFileError(f"No emulator file '{name}', and none of that name ships. Shipped: {names}.")


POLICIES = ("dolphin", "fish")
"""Systems whose policy ships, at 50 substeps."""


def shipped_policy(system: str) -> Path:
    """Return where the shipped policy of `system` lies."""
    return (
        Path(str(resources.files("neuroanimator"))) / "emulators" / f"{system}.policy.safetensors"
    )


def find_policy(name: str) -> Path:
    """Return the file `name` is, or the shipped policy of the system it names: `fish`."""
    path = Path(name)
    if path.is_file():
        return path
    if name in POLICIES and shipped_policy(name).is_file():
        return shipped_policy(name)
    raise BadFileError(
        f"No policy file '{name}', and none of that name ships. Shipped: {', '.join(POLICIES)}."
    )


LICENCE = "Apache-2.0"
"""Terms under which what ships may be used (SPDX)."""


def is_shipped(path: Path) -> bool:
    """Return whether the emulator or policy at `path` came with the package."""
    return path.parent == shipped_path(*SHIPPED[0]).parent


def licence_of(path: Path) -> str:
    """Return the licence of the emulator or policy at `path`: that of the package if it ships, else nothing is known."""
    return LICENCE if is_shipped(path) else ""
