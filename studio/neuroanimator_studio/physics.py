"""The true physics of mass-spring bodies for the page, which runs it in WebAssembly.

It goes beside an emulator, as what a page without a server compares that with; or it is what is shown, where it costs less
than an emulator (docs/decisions/0017-strides.md).
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator import System, load_system
from neuroanimator.authoring import (
    USUAL_SECONDS,
    DeformableSystem,
    Drive,
    EmulatorSpec,
    spec_of,
    throw_body,
    write_whole,
)
from neuroanimator_studio.catalogue import EMULATOR_WASM, PHYSICS_WASM
from neuroanimator_studio.description import describe_physics, short_numbers
from neuroanimator_studio.springs_module import (
    AS_EMULATOR,
    AS_REPLAY,
    physics_module,
)

SUPER_STEP = 0.02
"""Time of what the page calls a super step [s]: 50 a second, so that a bounce is seen where it happens."""


MODULE = "emulator"
"""How the names of its functions begin: the page calls it as it calls emulators."""

BESIDE = "physics"
"""The same where it goes beside an emulator."""


def physics_spec(system: System) -> EmulatorSpec:
    """Return what an emulator of `system` would say of it, in super steps of `SUPER_STEP`."""
    return spec_of(system, system.scheme.steps(SUPER_STEP), SUPER_STEP)


def write_physics_module(name: str, folder: Path) -> None:
    """Write the physics of the system `name` into its bundle's `folder`; errors are those of `physics_module`."""
    system = _deformable(name)
    write_whole(folder / EMULATOR_WASM, physics_module(system, SUPER_STEP, MODULE, AS_EMULATOR))


def write_physics_beside(system: System, dt: float, folder: Path) -> None:
    """Write the physics of `system` into the bundle's `folder` of its emulator; errors are those of `physics_module`.

    Its super steps are `dt` [s]. Nothing is written for systems that are no mass-spring bodies: their physics needs the server.
    """
    if isinstance(system, DeformableSystem):
        write_whole(folder / PHYSICS_WASM, physics_module(system, dt, BESIDE, AS_REPLAY))


def physics_facts(name: str, folder: Path) -> dict[str, Any]:
    """Return what `bundle.json` says of the system `name`, which is thrown; its module lies in `folder`."""
    system = _deformable(name)
    facts: dict[str, Any] = {"id": name}
    facts |= describe_physics(physics_spec(system), system)
    facts["sha256"] = hashlib.sha256((folder / EMULATOR_WASM).read_bytes()).hexdigest()
    facts["policy"] = None
    drive = thrown(system)
    facts["default_motion"] = {
        "start": short_numbers(drive.start),
        "controls": short_numbers(drive.controls),
    }
    facts["emulator"] = EMULATOR_WASM
    facts["descents"] = []
    return facts


def thrown(system: DeformableSystem) -> Drive:
    """Return the start of a throw, and controls that leave the body alone."""
    cloud = system.structure.cloud
    assert cloud is not None
    start = throw_body(cloud, np.array(system.rest))
    steps = round(USUAL_SECONDS / SUPER_STEP)
    return Drive(start, np.repeat(system.bounds.middle[None], steps, axis=0))


def _deformable(name: str) -> DeformableSystem:
    system = load_system(name)
    assert isinstance(system, DeformableSystem)
    return system
