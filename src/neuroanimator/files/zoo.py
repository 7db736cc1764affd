"""The emulators and policies that come with the package."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from neuroanimator.errors import BadFileError
from neuroanimator.text import did_you_mean

EMULATORS = Path(str(resources.files("neuroanimator"))) / "emulators"
"""Folder of everything that ships."""


@dataclass(frozen=True)
class ShippedSystem:
    """The emulators and the look of one shipped system: its table in `emulators/shipped.toml`."""

    about: str
    """The system in one line."""
    substeps: tuple[int, ...] = ()
    """Numbers of physics steps in a super step of its emulators, the usual one first."""
    goals: tuple[str, ...] = ()
    """Names of goals that are made in code."""
    scenery: str = "plain"
    """Surroundings in the studio, other than water."""
    has_policy: bool = False
    is_soft: bool = False
    """Whether it has thousands of nodes, emulated by the amplitudes of shapes."""
    has_muscles: bool = False
    """Whether it is soft, and swims by muscles of its own."""
    recipe: Mapping[str, Any] = field(default_factory=dict)
    """Recipe of its emulators: see `learn.training.recipes`."""
    large: Mapping[str, Any] = field(default_factory=dict)
    """Changes to the recipe for the large size."""


def _read_shipped() -> dict[str, ShippedSystem]:
    tables = tomllib.loads((EMULATORS / "shipped.toml").read_text(encoding="utf-8"))
    return {name: ShippedSystem(**_with_tuples(table)) for name, table in tables.items()}


def _with_tuples(table: dict[str, Any]) -> dict[str, Any]:
    """Return a TOML table, its arrays as tuples, so that they cannot be changed."""
    plain = {}
    for key, value in table.items():
        if isinstance(value, dict):
            value = _with_tuples(value)
        plain[key] = tuple(value) if isinstance(value, list) else value
    return plain


SHIPPED_SYSTEMS = _read_shipped()
"""Shipped systems by name."""

SHIPPED = [
    (name, n)
    for name, system in SHIPPED_SYSTEMS.items()
    for n in system.substeps
    if not system.is_soft
]
"""(system, substeps) of each emulator of usual size, except of soft bodies."""

DEFAULT_MOTIONS = EMULATORS / "motions.json"
"""File of the motions that show the systems with an emulator, by name (tools/default_motions.py)."""

SOFT = [(name, system.substeps[0]) for name, system in SHIPPED_SYSTEMS.items() if system.is_soft]
"""(system, substeps) of each emulator of a soft body."""

WITHOUT_EMULATOR = tuple(name for name, system in SHIPPED_SYSTEMS.items() if not system.substeps)
"""Systems without a shipped emulator: their physics costs less than an equally accurate one (docs/decisions/0017-strides.md)."""

LARGE = [(name, system.substeps[0]) for name, system in SHIPPED_SYSTEMS.items() if system.large]
"""(system, substeps) of those that also ship in a large size: slower and more accurate."""

POLICIES = tuple(name for name, system in SHIPPED_SYSTEMS.items() if system.has_policy)
"""Systems with a shipped policy, at the super step of their usual emulator."""


def shipped_path(system: str, substeps: int = 50, size: str = "") -> Path:
    """Return the path of the shipped emulator of `system` at `substeps`; `size` is "large", or empty for the usual one."""
    name = emulator_name(system, substeps, size)
    return EMULATORS / f"{name}.emulator.safetensors"


def emulator_name(system: str, substeps: int, size: str = "") -> str:
    """Return the name an emulator ships under: `pendulum-50` or `pendulum-50-large`."""
    name = f"{system}-{substeps}"
    return f"{name}-{size}" if size else name


def shipped_emulators() -> dict[str, Path]:
    """Return the paths of all shipped emulators, by name."""
    usual = {emulator_name(*row): shipped_path(*row) for row in [*SHIPPED, *SOFT]}
    large = {emulator_name(*row, "large"): shipped_path(*row, "large") for row in LARGE}
    return usual | large


def is_name(reference: str) -> bool:
    """Return whether `reference` may name a shipped file: it has no folder and no suffix."""
    return Path(reference).name == reference and not Path(reference).suffix


def find_emulator(name: str) -> Path:
    """Return the file `name` is, or the shipped emulator it names: `pendulum`, `pendulum-100` or `pendulum-50-large`."""
    path = Path(name)
    if path.is_file():
        return path
    shipped = shipped_emulators()
    usual = {system: shipped_path(system) for system, _ in SHIPPED}
    usual |= {system: shipped_path(system, substeps) for system, substeps in SOFT}
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
    like = did_you_mean(name, shipped | usual)
    raise BadFileError(
        f"No emulator file '{name}', and none of that name ships. {like}Shipped: {names}."
    )


def shipped_policy(system: str) -> Path:
    """Return the path of the shipped policy of `system`."""
    return EMULATORS / f"{system}.policy.safetensors"


def find_policy(name: str) -> Path:
    """Return the file `name` is, or the shipped policy of the system it names: `fish`."""
    path = Path(name)
    if path.is_file():
        return path
    if name in POLICIES and shipped_policy(name).is_file():
        return shipped_policy(name)
    raise BadFileError(
        f"No policy file '{name}', and none of that name ships. {did_you_mean(name, POLICIES)}"
        f"Shipped: {', '.join(POLICIES)}."
    )


LICENCE = "Apache-2.0"
"""Licence of the shipped files (SPDX)."""


def licence_of(path: Path) -> str:
    """Return the licence of the emulator or policy at `path`: that of the package if it ships, else unknown."""
    return LICENCE if path.parent == EMULATORS else ""
