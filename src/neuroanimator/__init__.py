"""NeuroAnimator: learn a physics model once, then animate and control it at a fraction of the cost."""

from __future__ import annotations

from typing import Any

from neuroanimator.lazy import lazy_names

_load, _names = lazy_names(__name__)


def __dir__() -> list[str]:
    return sorted([*_names(), "__version__"])


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    return _load(name)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("neuroanimator")
    except PackageNotFoundError:  # run from a source folder that is not installed
        return "unknown"
