"""Surfaces that are drawn outside of what strikes them."""

from __future__ import annotations

import numpy as np
import pytest
from soft_bodies import soft_clip, wavy_shapes

from neuroanimator import Clip
from neuroanimator.animation.push_out import keep_out
from neuroanimator.export.morphs import surface_nodes
from neuroanimator.state.shape_contacts import Collider, ShapeContacts

DEPTH = 1e-3
"""How far a node may be inside of a collider [m]."""

BALL = Collider(0, (0.1, 0.05, -0.5), (0.0, 0.0, 0.0), 0.2)
ARM = Collider(0, (-0.4, -0.1, -0.6), (0.5, 0.1, 0.0), 0.12)


def contacts_of(clip: Clip, *colliders: Collider) -> ShapeContacts:
    shapes = clip.skeleton.shapes
    assert shapes is not None
    return ShapeContacts(1, 0, colliders, 0.1, (0,), shapes.mean[:1], shapes.modes[:, :1])


def nodes_of(clip: Clip) -> np.ndarray:
    assert clip.skeleton.shapes is not None
    return clip.skeleton.shapes.decode(clip.states)


def depths(clip: Clip, collider: Collider) -> np.ndarray:
    """Return how far each node is inside of a collider in each frame [m]."""
    start = clip.states[:, None, :3] + np.array(collider.start)
    along = np.array(collider.along)
    away = nodes_of(clip) - start
    share = np.clip(away @ along / max(along @ along, 1e-30), 0, 1)
    return collider.radius - np.linalg.norm(away - share[..., None] * along, axis=-1)


@pytest.mark.parametrize("colliders", [(BALL,), (ARM,), (BALL, ARM)])
def test_nothing_drawn_is_inside_of_what_strikes_it(colliders: tuple[Collider, ...]):
    clip = soft_clip(wavy_shapes(24), frames=40)
    drawn = keep_out(clip, contacts_of(clip, *colliders))
    for collider in colliders:
        assert depths(clip, collider).max() > 0.05
        assert depths(drawn, collider).max() <= DEPTH


def test_nodes_far_from_all_stay_where_they_are_and_faces_are_outside_too():
    clip = soft_clip(wavy_shapes(24), frames=40)
    ball = BALL._replace(start=(0.1, 0.17, -0.5))
    contacts = contacts_of(clip, ball)
    drawn = keep_out(clip, contacts)
    depth = depths(clip, ball)
    moved = np.linalg.norm(nodes_of(drawn) - nodes_of(clip), axis=-1)
    assert moved[depth < -0.1].max() <= DEPTH
    assert (moved - depth)[depth > 0].min() >= -DEPTH
    np.testing.assert_array_equal(drawn.states[:, : clip.states.shape[1]], clip.states)
    assert clip.skeleton.shapes is not None
    middles = nodes_of(drawn)[:, clip.skeleton.shapes.faces].mean(axis=2)
    inside = np.linalg.norm(contacts.pushed_out(middles, drawn.states) - middles, axis=-1)
    assert inside.max() <= DEPTH


def test_pushing_twice_is_pushing_once_and_what_touches_nothing_is_left_alone():
    clip = soft_clip(wavy_shapes(24), frames=20)
    contacts = contacts_of(clip, BALL)
    drawn = keep_out(clip, contacts)
    again = contacts.pushed_out(nodes_of(drawn), drawn.states)
    assert np.abs(again - nodes_of(drawn)).max() <= DEPTH
    far = contacts_of(clip, BALL._replace(start=(5.0, 0.0, 0.0)))
    assert keep_out(clip, far) is clip


def test_new_shapes_are_as_the_others_are():
    """What draws surfaces counts on it: orthogonal, of root mean square 1 a node."""
    clip = soft_clip(wavy_shapes(24), frames=20)
    shapes = keep_out(clip, contacts_of(clip, BALL)).skeleton.shapes
    assert shapes is not None
    modes = shapes.modes.reshape(len(shapes.modes), -1)
    np.testing.assert_allclose(modes @ modes.T / len(shapes.mean), np.eye(len(modes)), atol=1e-6)


def test_the_morph_targets_of_a_surface_tell_of_the_push():
    clip = soft_clip(wavy_shapes(24), frames=20)
    drawn = keep_out(clip, contacts_of(clip, BALL))
    assert drawn.skeleton.shapes is not None
    (node,) = surface_nodes(drawn.skeleton.shapes, [drawn.states])
    points = node.morphs.points + node.positions[:, None]
    for number, target in enumerate(node.morphs.moving):
        weights = node.weights[:, number, None, None]
        points = points + node.morphs.scale * weights * target.deltas
    assert np.abs(points - nodes_of(drawn)).max() < 0.01
