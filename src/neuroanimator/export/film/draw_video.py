"""Takes drawn image by image by MuJoCo and encoded as they come: what the drawing process of a video does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import imageio_ffmpeg
import mujoco
import numpy as np
from jaxtyping import UInt8

from neuroanimator.export.film.camera import Shots
from neuroanimator.export.film.caption import caption_image
from neuroanimator.export.film.clip_bytes import unpack_takes
from neuroanimator.export.film.edges import smooth_edges
from neuroanimator.export.film.options import Film
from neuroanimator.export.film.rigid_scene import RigidScene
from neuroanimator.export.film.scene import Scene
from neuroanimator.export.film.skeleton_scene import Setting, SkeletonScene
from neuroanimator.export.film.takes import Take
from neuroanimator.export.film.trust_shown import TrustStrip
from neuroanimator.systems import carried_system
from neuroanimator.systems.loading import MissingPhysicsError
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem


class Quality(NamedTuple):
    """How finely images are drawn."""

    shadow_map: int
    """A side of the shadow map [texels]."""
    scale: int
    """Factor by which images are drawn larger, to be made smaller by averaging."""
    loss: int
    """ffmpeg's constant rate factor: 20 shows no loss, 6 more halve the file."""


FINE = Quality(shadow_map=2048, scale=1, loss=20)
"""Shadows have edges hardly coarser than a pixel; a map of four times as many texels takes as long as all the rest."""

QUICK = Quality(shadow_map=1024, scale=2, loss=25)
"""Small pictures have edges smoothed by averaging."""

MAX_SLICES = 32
"""Maximum number of sides of a round shape: more take longer, and are not seen."""

ENCODER = ["-preset", "superfast", "-movflags", "+faststart"]
"""What ffmpeg is told: the next slower preset makes files a third smaller, in twice the time, which drawing needs."""

BLOCK = 2
"""Number of pixels of which H.264 wants every side to be a multiple."""


def draw_video(out: str, content: bytes) -> None:
    """Write the takes, packed by `pack_takes`, to `out`; print the number of each image as it is done."""
    takes, film = unpack_takes(content)
    quality = _quality(film)
    writer = imageio_ffmpeg.write_frames(
        out,
        film.size,
        fps=takes[0].clips[0].rate,  # pyright: ignore[reportArgumentType]
        quality=None,  # pyright: ignore[reportArgumentType]
        macro_block_size=BLOCK,
        output_params=[*ENCODER, "-crf", str(quality.loss)],
    )
    writer.send(None)
    done = 0
    for take in takes:
        for image in _images(take, film):
            writer.send(np.ascontiguousarray(image))
            done += 1
            print(done, flush=True)
    writer.close()


def _images(take: Take, film: Film) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    """Yield the images of a take, one after another."""
    quality = _quality(film)
    width, height = (quality.scale * side for side in film.size)
    caption = caption_image(take.caption, film.size)
    strip = TrustStrip(take.clips[0], film.size)
    scene = scene_of(take, film)
    visual = scene.model.vis
    visual.global_.offwidth = width
    visual.global_.offheight = height
    # OpenGL in software samples a pixel several times in twice the time.
    visual.quality.offsamples = 0
    visual.quality.numslices = min(visual.quality.numslices, MAX_SLICES)
    visual.quality.shadowsize = quality.shadow_map
    with mujoco.Renderer(scene.model, height, width) as renderer:
        scene.prepare(renderer.scene)
        for frame in range(take.frames):
            scene.pose(frame)
            renderer.update_scene(scene.data, camera=_camera(scene.shots, frame))
            scene.fill(renderer.scene)
            drawn = renderer.render()
            image = averaged(drawn, quality.scale) if quality.scale > 1 else smooth_edges(drawn)
            below = np.concatenate([strip.at(frame), caption])
            image[len(image) - len(below) :] = below
            yield image
            if frame == take.frames - 1:
                yield from [image] * take.held


def _quality(film: Film) -> Quality:
    return QUICK if film.is_quick else FINE


def averaged(image: UInt8[np.ndarray, "H W 3"], scale: int) -> UInt8[np.ndarray, "h w 3"]:
    """Return the image with the mean of each `scale` times `scale` pixels as one."""
    total = np.zeros((image.shape[0] // scale, image.shape[1] // scale, 3), np.uint16)
    for row in range(scale):
        for column in range(scale):
            total += image[row::scale, column::scale]
    return (total // scale**2).astype(np.uint8)


def _camera(shots: Shots, frame: int) -> mujoco.MjvCamera:
    """Return MuJoCo's camera in `frame`."""
    camera = mujoco.MjvCamera()
    camera.lookat[:] = shots.lookat[frame]
    camera.azimuth, camera.elevation, camera.distance = shots.angles(frame)
    return camera


def scene_of(take: Take, film: Film) -> Scene:
    """Return what is filmed of a take: rigid bodies as MuJoCo has them, others, and models not at hand, as their skeletons."""
    try:
        system = carried_system(take.clips[0].name, take.clips[0].definition)
    except MissingPhysicsError:
        return SkeletonScene(take, film, Setting(surface=None, has_ground=True))
    if isinstance(system, MujocoSystem):
        return RigidScene(system, take, film)
    return SkeletonScene(take, film, Setting(system.water_surface, system.has_ground))
