"""How a ghost looks, in scenes and films: another motion of the same body at the same place and time."""

from __future__ import annotations

GHOST_COLOUR = (0.95, 0.1, 0.7)
"""The sRGB colour of a ghost: a magenta that no body has."""

GHOST_OPACITY = 0.45
"""The opacity of a ghost: the body behind stays visible, and the ghost too where it is elsewhere."""

GHOST_RGBA = (*GHOST_COLOUR, GHOST_OPACITY)
"""Both, as MuJoCo takes them."""

GHOST_GROWTH = 1.006
"""Factor by which a ghost is drawn larger in films: where it is as the body is, neither shows through the other in spots."""
