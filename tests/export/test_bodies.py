"""A scene's bodies are the same for every format: bones after their parents, scenery once, one skin a school."""

from __future__ import annotations

import numpy as np
import pytest

from neuroanimator import Clip, load_system
from neuroanimator.export.bodies import GHOST, bodies_of


def still(name: str, frames: int = 3) -> Clip:
    system = load_system(name)
    states = np.repeat(system.rest[None], frames, axis=0)
    return Clip(name, system.skeleton, np.arange(frames) / 30, states)


@pytest.mark.parametrize("name", ["truck", "fish"])
def test_bones_come_after_their_parents_and_have_the_poses_of_the_skeleton(name: str):
    clip = still(name)
    (body,) = bodies_of(clip, None)
    positions, _ = clip.skeleton.local_poses(clip.states)
    for number, node in enumerate(body.nodes):
        assert node.bone.parent < number
        np.testing.assert_array_equal(node.positions, positions[:, number])


def test_the_scenery_is_that_of_the_first_body_and_a_ghost_has_one_paint():
    first, second = bodies_of([still("truck"), still("truck")], None)
    assert (first.title, second.title) == ("truck 1", "truck 2")
    shapes = [sum(len(node.shapes) for node in body.nodes) for body in (first, second)]
    assert shapes[0] > shapes[1] > 0
    _, ghost = bodies_of(still("truck"), still("truck"))
    assert ghost.is_ghost
    assert {paint for node in ghost.nodes for _, paint in node.shapes} == {GHOST}


def test_a_school_has_one_skin_whose_parts_hold_every_triangle_once():
    bodies = bodies_of([still("fish")] * 3, None)
    skins = [body.skin for body in bodies]
    assert skins[0] is skins[1] is skins[2]
    skin = skins[0]
    assert skin is not None
    triangles = np.concatenate(list(skin.parts.values()))
    np.testing.assert_array_equal(np.sort(triangles), np.arange(len(skin.mesh.triangles)))
    assert skin.joints.max() < len(skin.rest) == 1 + len(bodies[0].nodes)
