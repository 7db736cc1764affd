"""Pictures of a motion as it happens: unlike a film's camera, this one does not know the future."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.errors import ArgumentError
from neuroanimator.film.bounding_boxes import bounding_boxes
from neuroanimator.film.graphics import needed_graphics
from neuroanimator.film.options import Film, Picture, Take

if TYPE_CHECKING:
    from neuroanimator.film.drawing import Canvas

SIZE = (480, 360)
"""Width and height of a picture [pixels]."""


@final
class LiveCamera:
    """Pictures of an emulator's states; `close` it when done."""

    def __init__(self, spec: EmulatorSpec):
        self._spec = spec
        self._canvas: Canvas | None = None

    def __reduce__(self) -> tuple[type[LiveCamera], tuple[EmulatorSpec]]:
        """Return what is pickled: the graphics library's memory stays here."""
        return LiveCamera, (self._spec,)

    def picture(self, state: Float[np.ndarray, " S"]) -> Picture:
        """Return the picture of `state`; ResourceError if nothing can be drawn here."""
        spec = self._spec
        twice = np.repeat(np.asarray(state, float)[None], 2, axis=0)
        clip = Clip(spec.system, spec.skeleton, np.arange(2.0), twice, spec.definition)
        if self._canvas is None:
            needed_graphics()
            from neuroanimator.film.drawing import Canvas, scene_of

            scene, shots = scene_of(Take((clip,)), Film(SIZE))
            self._angles = shots.angles(0)
            self._canvas = Canvas(scene, SIZE)
        self._canvas.scene.pose([state])
        return self._canvas.draw(bounding_boxes([clip]).centres[0], self._angles)

    def close(self) -> None:
        """Free the graphics library's memory."""
        if self._canvas is not None:
            self._canvas.close()
        self._canvas = None


def checked_render_mode(mode: str | None) -> str | None:
    """Return `mode` if it is a known render mode; ArgumentError otherwise."""
    if mode not in (None, "rgb_array"):
        raise ArgumentError(f"No render mode called '{mode}'. Modes: rgb_array.")
    return mode
