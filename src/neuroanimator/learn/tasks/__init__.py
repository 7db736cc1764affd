"""Tasks that measure controllers: random starts, objectives, and criteria of success on the physics."""

from __future__ import annotations

from neuroanimator.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__)
