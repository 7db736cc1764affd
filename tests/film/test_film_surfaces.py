"""The surface of a soft body in films: both of its sides, and all of it in the picture."""

from __future__ import annotations

import pytest
from soft_bodies import soft_clip, wavy_shapes

from neuroanimator.film.bounding_boxes import bounding_boxes
from neuroanimator.film.camera import take_shots
from neuroanimator.film.graphics import graphics_backend
from neuroanimator.film.options import Film, Take
from neuroanimator.film.skeleton_scene import SkeletonScene


def test_both_sides_of_a_surface_are_filmed_in_its_colour():
    if graphics_backend() is None:
        pytest.skip("no OpenGL here")
    from neuroanimator.film.drawing import Canvas

    clip = soft_clip(wavy_shapes(), frames=2)
    take = Take((clip,))
    film = Film((160, 90), "front")
    shots = take_shots(take, film)
    scene = SkeletonScene(take, shots, None)
    scene.pose([clip.states[0]])
    canvas = Canvas(scene, film.size)
    azimuth, elevation, distance = shots.angles(0)
    for turn in (90, 270):
        angles = (azimuth + turn, elevation, distance)
        image = canvas.draw(shots.lookat[0], angles).astype(float)
        is_red = (image[..., 0] > 60) & (image[..., 0] > 2 * image[..., 1])
        assert 0.04 < is_red.mean() < 0.7
    canvas.close()


def test_the_camera_has_all_nodes_in_the_picture():
    clip = soft_clip(wavy_shapes())
    assert clip.skeleton.shapes is not None
    nodes = clip.skeleton.shapes.decode(clip.states)
    boxes = bounding_boxes([clip])
    assert (boxes.low[:, None] <= nodes + 1e-9).all()
    assert (boxes.high[:, None] >= nodes - 1e-9).all()
