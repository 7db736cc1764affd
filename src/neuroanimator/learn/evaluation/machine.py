"""The machine a figure was measured on: processor, cores and versions."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version

from neuroanimator.codegen.cores import processor_facts

PACKAGES = ("jax", "mujoco", "numpy")
"""Packages whose versions are written with every table."""


def describe_machine() -> str:
    """Return processor, cores and versions in one line."""
    system = platform.system()
    python = platform.python_version()
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return f"{_processor()}, {os.cpu_count()} cores, {system}, Python {python}, {packages}, float32"


def _processor() -> str:
    named = processor_facts("model name")
    return named[0].partition(":")[2].strip() if named else platform.machine()
