"""What a film needs of a scene: a MuJoCo model that can be posed image by image."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import mujoco

from neuroanimator.export.film.camera import Shots


@runtime_checkable
class Scene(Protocol):
    """What is filmed: a model, its state in the present image, and the camera in every image."""

    model: mujoco.MjModel
    data: mujoco.MjData
    shots: Shots

    def prepare(self, scene: mujoco.MjvScene) -> None:
        """Set how `scene` is drawn."""

    def pose(self, frame: int) -> None:
        """Put everything where it is in `frame`."""

    def fill(self, scene: mujoco.MjvScene) -> None:
        """Change what MuJoCo has put into `scene`."""
