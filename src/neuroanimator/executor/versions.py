"""Versions of this package and of those that compute: the bytes of a result depend on them besides the task."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("jax", "jaxlib", "mujoco", "numpy", "equinox", "optax")
"""The packages whose versions must agree between all workers."""

OWN = "neuroanimator"
"""Key of this package among them: its value is its version and the sha256 of its code."""

CODE_DIGITS = 8
"""Number of digits of that sha256 compared and shown."""


def installed_versions() -> dict[str, str]:
    """Return the version of each package that matters, and of this one."""
    return dict(_versions_found())


@cache
def _versions_found() -> dict[str, str]:
    found = {OWN: f"{_version(OWN)} ({_code_hash()})"}
    for name in PACKAGES:
        found[name] = _version(name)
    return found


def difference(here: dict[str, str], there: dict[str, str]) -> str:
    """Return the first version that differs, in words; empty if none does."""
    for name, wanted in here.items():
        came = there.get(name, "none")
        if came != wanted:
            return f"{name} {came}, here {wanted}"
    return ""


def machine_name() -> str:
    """Return what this machine calls itself."""
    return platform.node() or "a node"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "none"


def _code_hash() -> str:
    package = Path(__file__).parents[1]
    total = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        total.update(path.relative_to(package).as_posix().encode())
        total.update(path.read_bytes())
    return total.hexdigest()[:CODE_DIGITS]
