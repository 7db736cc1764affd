"""Takes drawn frame by frame by MuJoCo, without a screen."""

from __future__ import annotations

import atexit
import importlib
import os
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from typing import Any, final

import mujoco
import numpy as np

from neuroanimator.film.camera import Shots, take_shots
from neuroanimator.film.footer import Footer
from neuroanimator.film.graphics import context_module, needed_graphics
from neuroanimator.film.options import Film, Picture, Take, Vector, held
from neuroanimator.film.rigid_scene import RigidScene
from neuroanimator.film.scene import OPTIONS, FilmScene, doubts
from neuroanimator.film.skeleton_scene import SkeletonScene
from neuroanimator.physics import carried_system
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.named_files import MissingPhysicsError
from neuroanimator.terminal import Bar

SAMPLES = 4
"""Number of samples per pixel, for smooth edges."""

SHADOW_MAP = 2048
"""Side of the shadow map [texels]: edges are hardly coarser than a pixel."""

MAX_SLICES = 32
"""Maximum number of sides of a round shape: more take longer and are invisible."""

MAX_SHAPES = 10_000
"""Maximum number of shapes in a picture."""

LIGHT_DISTANCE = 3.0
"""Distance of a light like the sun, which moves with the camera, over the camera's distance."""


@final
class Canvas:
    """Pictures of a scene; `close` it when done."""

    def __init__(self, scene: FilmScene, size: tuple[int, int]):
        """Prepare pictures of `size` (width, height) [pixels]; ResourceError if nothing can be drawn."""
        backend = needed_graphics()
        width, height = size
        self.scene = scene
        model = scene.model
        model.vis.global_.offwidth = width
        model.vis.global_.offheight = height
        model.vis.quality.offsamples = SAMPLES
        model.vis.quality.shadowsize = SHADOW_MAP
        model.vis.quality.numslices = min(model.vis.quality.numslices, MAX_SLICES)
        is_sun = model.light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        self._suns = np.flatnonzero(is_sun & (model.light_bodyid == 0))
        self._shapes = mujoco.MjvScene(model, MAX_SHAPES)
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        with _loading(backend):
            self._context: Any = importlib.import_module(context_module(backend)).GLContext(*size)
            self._context.make_current()
            self._target = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._target)
        # A canvas left open must be freed before the graphics library.
        atexit.register(self.close)

    def draw(self, lookat: Vector, angles: tuple[float, float, float]) -> Picture:
        """Return the picture of the scene as it is posed; `angles` are those of `Shots.angles`."""
        scene = self.scene
        camera = mujoco.MjvCamera()
        camera.lookat[:] = lookat
        camera.azimuth, camera.elevation, camera.distance = angles
        for sun in self._suns:
            offset = LIGHT_DISTANCE * camera.distance * scene.model.light_dir[sun]
            scene.model.light_pos[sun] = camera.lookat - offset
        mujoco.mj_camlight(scene.model, scene.data)
        mujoco.mjv_updateScene(
            scene.model, scene.data, *OPTIONS, camera, mujoco.mjtCatBit.mjCAT_ALL, self._shapes
        )
        scene.fill(self._shapes)
        image = np.empty((self._rectangle.height, self._rectangle.width, 3), np.uint8)
        self._context.make_current()
        mujoco.mjr_render(self._rectangle, self._shapes, self._target)
        mujoco.mjr_readPixels(image, None, self._rectangle, self._target)
        return image[::-1]

    def close(self) -> None:
        """Free the graphics library's memory."""
        atexit.unregister(self.close)
        self._context.make_current()
        self._target.free()
        self._context.free()


def scene_of(take: Take, film: Film) -> tuple[FilmScene, Shots]:
    """Return the scene of a take, and the camera: rigid bodies as MuJoCo draws them, others as bones and skins.

    Models that are missing, several bodies with a MuJoCo skin, of which it has only one, and those that wear something
    are filmed as bones, too.
    """
    clip = take.clips[0]
    system = None
    with suppress(MissingPhysicsError):
        system = carried_system(clip.name, clip.definition)
    if isinstance(system, MujocoSystem):
        is_one_body = all(other.name == clip.name for other in take.everything)
        if is_one_body and (not system.model.nskin or len(take.everything) == 1):
            shots = take_shots(take, film)
            return RigidScene(system, take, shots), shots
        system = None
    shots = take_shots(take, film, None if system is None else system.water_surface)
    return SkeletonScene(take, shots, system), shots


def draw_takes(takes: Sequence[Take], film: Film, bar: Bar) -> Iterator[Picture]:
    """Yield the images of the takes, one after another."""
    for take in takes:
        footer = Footer(take, film.size)
        scene, shots = scene_of(take, film)
        motions = [held(clip.states, take.frames) for clip in take.everything]
        glow = doubts(take.clips[0], take.frames)
        with closing(Canvas(scene, film.size)) as canvas:
            for frame in range(take.frames):
                scene.pose([states[frame] for states in motions])
                scene.doubt = float(glow[frame])
                image = canvas.draw(shots.lookat[frame], shots.angles(frame))
                footer.write(image, frame)
                yield image
                bar.advance()


@contextmanager
def _loading(backend: str) -> Iterator[None]:
    """Make MuJoCo load the functions of this graphics library, which happens when it first draws."""
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = backend
    try:
        yield
    finally:
        del os.environ["MUJOCO_GL"]
        if before is not None:
            os.environ["MUJOCO_GL"] = before
