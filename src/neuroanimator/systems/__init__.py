"""What a system is, as the rest of the package sees it, and the systems that ship."""

from __future__ import annotations

import tomllib
from importlib import resources

from neuroanimator.files.zoo import SHIPPED_SYSTEMS


def goal_names(name: str) -> tuple[str, ...]:
    """Return the goals of the shipped system called `name`, without making its physics."""
    file = resources.files("neuroanimator.systems") / "assets" / f"{name}.toml"
    if not file.is_file():
        return SHIPPED_SYSTEMS[name].goals
    return tuple(tomllib.loads(file.read_text()).get("goals", {}))
