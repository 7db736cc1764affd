"""Colours: screens show sRGB, glTF computes with amounts of light (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

DARK = 0.04045
"""Value up to which sRGB is a straight line."""

SLOPE = 12.92
"""Slope of that line: sRGB per amount of light."""

OFFSET = 0.055
"""Offset that, added to sRGB beyond that line, makes it proportional to a power of the light."""

EXPONENT = 2.4
"""Exponent of the light as a function of sRGB, beyond the straight line."""


def linear_of(colours: ArrayLike) -> Float[np.ndarray, "*B"]:
    """Return the amounts of light that sRGB `colours` (of any shape) stand for, all 0 to 1 (IEC 61966-2-1)."""
    screen = np.clip(np.asarray(colours, float), 0.0, 1.0)
    bright = ((screen + OFFSET) / (1 + OFFSET)) ** EXPONENT
    return np.where(screen <= DARK, screen / SLOPE, bright)
