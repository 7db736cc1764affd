"""Surfaces that are drawn outside of what strikes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from soft_bodies import soft_clip, wavy_shapes

from neuroanimator import Clip
from neuroanimator.animation.push_out import keep_out
from neuroanimator.export.morphs import surface_nodes
from neuroanimator.state.shape_contacts import BoxCollider, RoundCollider, ShapeContacts

DEPTH = 1e-3
"""How far a node may be inside of a collider [m]."""

BALL = RoundCollider(0, (0.1, 0.05, -0.5), (0.0, 0.0, 0.0), 0.2)
ARM = RoundCollider(0, (-0.4, -0.1, -0.6), (0.5, 0.1, 0.0), 0.12)


def contacts_of(clip: Clip, *colliders: RoundCollider) -> ShapeContacts:
    shapes = clip.skeleton.shapes
    assert shapes is not None
    return ShapeContacts(
        turning=(False,),
        anchor=0,
        capsules=colliders,
        boxes=(),
        ground=None,
        wind=(0.0, 0.0, 0.0),
        reach=0.1,
        nodes=(0,),
        mean=shapes.mean[:1],
        modes=shapes.modes[:, :1],
    )


def nodes_of(clip: Clip) -> np.ndarray:
    assert clip.skeleton.shapes is not None
    return clip.skeleton.shapes.decode(clip.states)


def own_nodes_of(clip: Clip) -> np.ndarray:
    assert clip.skeleton.shapes is not None
    return clip.skeleton.shapes.unplaced(clip.states)


def depths(clip: Clip, collider: RoundCollider) -> np.ndarray:
    """Return how far each node is inside of a collider in each frame [m]."""
    start = clip.states[:, None, :3] + np.array(collider.start)
    along = np.array(collider.along)
    away = nodes_of(clip) - start
    share = np.clip(away @ along / max(along @ along, 1e-30), 0, 1)
    return collider.radius - np.linalg.norm(away - share[..., None] * along, axis=-1)


@pytest.mark.parametrize("colliders", [(BALL,), (ARM,), (BALL, ARM)])
def test_nothing_drawn_is_inside_of_what_strikes_it(colliders: tuple[RoundCollider, ...]):
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
    middles = own_nodes_of(drawn)[:, clip.skeleton.shapes.faces].mean(axis=2)
    inside = np.linalg.norm(contacts.pushed_out(middles, drawn.states) - middles, axis=-1)
    assert inside.max() <= DEPTH


def test_pushing_twice_is_pushing_once_and_what_touches_nothing_is_left_alone():
    clip = soft_clip(wavy_shapes(24), frames=20)
    contacts = contacts_of(clip, BALL)
    drawn = keep_out(clip, contacts)
    nodes = own_nodes_of(drawn)
    assert np.abs(contacts.pushed_out(nodes, drawn.states) - nodes).max() <= DEPTH
    far = contacts_of(clip, BALL._replace(start=(5.0, 0.0, 0.0)))
    assert keep_out(clip, far) is clip


def test_boxes_and_the_ground_keep_a_surface_out_too():
    clip = soft_clip(wavy_shapes(24), frames=20)
    half = (0.2, 0.06, 0.2)
    box = BoxCollider(0, (0.1, 0.0, -0.5), half, 0.0)
    height = 0.65
    contacts = replace(contacts_of(clip), boxes=(box,), ground=height)
    nodes = nodes_of(keep_out(clip, contacts))
    assert nodes_of(clip)[..., 2].min() < height - 0.05
    assert nodes[..., 2].min() >= height - DEPTH
    local = np.abs(nodes - clip.states[:, None, :3] - np.array(box.centre))
    assert (np.array(half) - local).min(axis=-1).max() <= DEPTH


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
