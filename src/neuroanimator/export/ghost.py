"""How a ghost looks, in scenes and films: another motion of the same body at the same place and time."""

from __future__ import annotations

GHOST_COLOUR = (0.95, 0.1, 0.7)
"""Colour of a ghost (sRGB): a magenta that no body has."""

GHOST_OPACITY = 0.45
"""Opacity of a ghost: the body behind it stays visible, and so does a ghost away from it."""

GHOST_RGBA = (*GHOST_COLOUR, GHOST_OPACITY)
"""Colour and opacity, as MuJoCo takes them."""

GHOST_GROWTH = 1.006
"""Factor by which a ghost is drawn larger in films: where both coincide, neither shows through the other in spots."""
