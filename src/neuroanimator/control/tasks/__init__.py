"""Tasks controllers are measured by: random starts, what is wanted, and when the physics has done it."""

from __future__ import annotations

from neuroanimator.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__)
