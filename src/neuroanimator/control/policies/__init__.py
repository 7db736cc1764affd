"""Motor controllers that are learnt once, what steers them, and how bodies behave that steer themselves."""

from __future__ import annotations

from neuroanimator.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__)
