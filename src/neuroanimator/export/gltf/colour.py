"""Colours: screens show sRGB, glTF computes with light."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

DARK, SLOPE = 0.04045, 12.92
"""sRGB is a straight line up to here (IEC 61966-2-1)."""
OFFSET, EXPONENT = 0.055, 2.4
"""And a power above."""


def linear_of(colours: ArrayLike) -> np.ndarray:
    """Return the amounts of light (..., 3) that sRGB `colours` (..., 3) stand for, all 0 to 1 (IEC 61966-2-1)."""
    shown = np.clip(np.asarray(colours, float), 0.0, 1.0)
    bright = ((shown + OFFSET) / (1 + OFFSET)) ** EXPONENT
    return np.where(shown <= DARK, shown / SLOPE, bright)


def screen_of(light: ArrayLike) -> np.ndarray:
    """Return the sRGB colours (..., 3) of amounts of `light` (..., 3): the inverse of `linear_of`."""
    amounts = np.clip(np.asarray(light, float), 0.0, 1.0)
    bright = (1 + OFFSET) * amounts ** (1 / EXPONENT) - OFFSET
    return np.where(amounts <= DARK / SLOPE, amounts * SLOPE, bright)
