"""Motor controllers learnt once, their steering, and behaviours of bodies that steer themselves."""

from __future__ import annotations

from neuroanimator.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__)
