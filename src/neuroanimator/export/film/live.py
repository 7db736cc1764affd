"""Pictures of a motion as it happens: unlike a film's camera, this one does not know the future."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
from jaxtyping import Float, UInt8

from neuroanimator.animation.clip import Clip
from neuroanimator.emulator.spec import EmulatorSpec
from neuroanimator.errors import ArgumentError
from neuroanimator.export.film.bounding_boxes import bounding_boxes
from neuroanimator.export.film.graphics import needed_graphics
from neuroanimator.export.film.options import Film, Take

if TYPE_CHECKING:
    from neuroanimator.export.film.drawing import Canvas

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

    def picture(self, state: Float[np.ndarray, " S"]) -> UInt8[np.ndarray, "H W 3"]:
        """Return the picture of `state`; ResourceError if nothing can be drawn here."""
        clip = self._clip(state)
        middle = bounding_boxes([clip]).centres[0]
        if self._canvas is None:
            self._canvas = self._new_canvas(clip)
        self._scene.pose([state])
        return self._canvas.draw(middle, self._angles)

    def _new_canvas(self, clip: Clip) -> Canvas:
        needed_graphics()
        from neuroanimator.export.film.drawing import Canvas, scene_of

        self._scene, shots = scene_of(Take((clip,)), Film(SIZE))
        self._angles = shots.angles(0)
        return Canvas(self._scene, SIZE)

    def close(self) -> None:
        """Free the graphics library's memory."""
        if self._canvas is not None:
            self._canvas.close()
        self._canvas = None

    def _clip(self, state: Float[np.ndarray, " S"]) -> Clip:
        """Return a clip of two frames, both in `state`."""
        spec = self._spec
        states = np.repeat(np.asarray(state, float)[None], 2, axis=0)
        return Clip(spec.system, spec.skeleton, np.arange(2.0), states, spec.definition)


def checked_render_mode(mode: str | None) -> str | None:
    """Return `mode` if it is a known render mode; ArgumentError otherwise."""
    if mode not in (None, "rgb_array"):
        raise ArgumentError(f"No render mode called '{mode}'. Modes: rgb_array.")
    return mode
