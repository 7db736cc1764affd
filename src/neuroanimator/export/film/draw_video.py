"""Clips drawn image by image by MuJoCo and encoded as they come: what the drawing process of a video does."""

from __future__ import annotations

from collections.abc import Sequence

import imageio_ffmpeg
import mujoco
import numpy as np

from neuroanimator.animation.clip import Clip
from neuroanimator.export.film.camera import Shots
from neuroanimator.export.film.clip_bytes import unpack_clips
from neuroanimator.export.film.options import Film
from neuroanimator.export.film.rigid_scene import RigidScene
from neuroanimator.export.film.scene import Scene
from neuroanimator.export.film.skeleton_scene import Setting, SkeletonScene
from neuroanimator.systems import carried_system
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem

SAMPLES = 8
"""Points a pixel is sampled at; OpenGL gives as many as it has, software 4."""

SHADOW_MAP = 4096
"""A side of the shadow map [texels]: shadows have edges finer than a pixel."""

ENCODER = ["-preset", "veryfast", "-crf", "18", "-movflags", "+faststart"]
"""What ffmpeg is told: H.264 without visible loss; slower presets make files a fifth smaller and take as long as
drawing."""

BLOCK = 2
"""H.264 wants sides that are multiples of so many pixels."""


def draw_video(out: str, content: bytes) -> None:
    """Write the video of clips, packed by `pack_clips`, to `out`; print the number of each image as it is done."""
    clips, film = unpack_clips(content)
    scene = scene_of(clips, film)
    width, height = film.size
    visual = scene.model.vis
    visual.global_.offwidth = width
    visual.global_.offheight = height
    visual.quality.offsamples = SAMPLES
    visual.quality.shadowsize = SHADOW_MAP
    writer = imageio_ffmpeg.write_frames(
        out,
        film.size,
        fps=clips[0].rate,  # pyright: ignore[reportArgumentType]
        quality=None,  # pyright: ignore[reportArgumentType]
        macro_block_size=BLOCK,
        output_params=ENCODER,
    )
    writer.send(None)
    with mujoco.Renderer(scene.model, height, width) as renderer:
        scene.prepare(renderer.scene)
        for frame in range(len(scene.shots.lookat)):
            scene.pose(frame)
            renderer.update_scene(scene.data, camera=_camera(scene.shots, frame))
            scene.fill(renderer.scene)
            writer.send(np.ascontiguousarray(renderer.render()))
            print(frame + 1, flush=True)
    writer.close()


def _camera(shots: Shots, frame: int) -> mujoco.MjvCamera:
    """Return MuJoCo's camera in `frame`."""
    camera = mujoco.MjvCamera()
    camera.lookat[:] = shots.lookat[frame]
    camera.azimuth, camera.elevation, camera.distance = shots.angles(frame)
    return camera


def scene_of(clips: Sequence[Clip], film: Film) -> Scene:
    """Return what is filmed of `clips`: rigid bodies as MuJoCo has them, others as their skeletons have them."""
    system = carried_system(clips[0].name, clips[0].definition)
    if isinstance(system, MujocoSystem):
        return RigidScene(system, clips, film)
    return SkeletonScene(clips, film, Setting(system.water_surface, system.has_ground))
