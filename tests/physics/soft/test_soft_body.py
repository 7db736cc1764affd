"""Laws of soft bodies' physics: what is conserved, what converges, what holds."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from soft_bodies import poses_of

from neuroanimator.physics.soft import constraints
from neuroanimator.physics.soft.program import LANES, SoftProgram
from neuroanimator.physics.soft.soft_body import (
    Air,
    MovingPlane,
    SoftBody,
    tetrahedron_volumes,
)
from neuroanimator.state.shape_contacts import RoundCollider

NO_TETRAHEDRA = np.zeros((0, 4), int)
NO_FACES = np.zeros((0, 3), int)


def ball(radius):
    """Return a sphere of the second mover."""
    return RoundCollider(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), radius)


def springs(positions, pairs, stiffness=10.0, pins=(), **others):
    """Return a body of equal springs and of nodes of 0.1 kg."""
    positions = np.array(positions, float)
    return SoftBody(
        positions,
        np.full(len(positions), 0.1),
        others.pop("faces", NO_FACES),
        np.array(pairs, int).reshape(-1, 2),
        np.full(len(pairs), stiffness),
        np.zeros(len(pairs)),
        others.pop("tetrahedra", NO_TETRAHEDRA),
        others.pop("bulk_stiffness", np.zeros(0)),
        np.array(pins, int),
        others.pop("air", Air(drag=0.0)),
        **others,
    )


def cloth(size=8, **others):
    """Return a square of springs hung by its first row."""
    line = np.linspace(0, 0.5, size)
    x, z = np.meshgrid(line, -line)
    nodes = np.arange(size * size).reshape(size, size)
    along = np.stack([nodes[:, :-1].ravel(), nodes[:, 1:].ravel()], axis=1)
    down = np.stack([nodes[:-1].ravel(), nodes[1:].ravel()], axis=1)
    across = np.stack([nodes[:-1, :-1].ravel(), nodes[1:, 1:].ravel()], axis=1)
    faces = np.stack(
        [nodes[:-1, :-1].ravel(), nodes[1:, :-1].ravel(), nodes[1:, 1:].ravel()], axis=1
    )
    positions = np.stack([x.ravel(), np.zeros(size * size), z.ravel()], axis=1)
    return springs(
        positions,
        np.concatenate([along, down, across]),
        stiffness=200.0,
        pins=nodes[0],
        faces=faces,
        **others,
    )


def play(
    body, frames=30, steps=20, duration=1 / 30, velocities=None, movers=None, dtype=np.float64
):
    """Return positions and velocities; `movers` (frames + 1, M, 4) have headings, and stand still if none are given."""
    if velocities is None:
        velocities = np.zeros_like(body.positions)
    if movers is None:
        movers = np.zeros((frames + 1, 1, 4))
    program = SoftProgram(body, dtype=dtype)
    return program.play(body.positions, velocities, poses_of(movers), duration, steps)


def beside_the_world(path):
    """Return poses of two movers: one that stands still, and one along `path` (frames + 1, 3 ...)."""
    poses = np.zeros((len(path), 2, 4, *path.shape[2:]))
    poses[:, 1, :3] = path
    return poses


def test_the_push_of_a_tetrahedron_is_along_the_slope_of_its_volume():
    corners = jax.random.normal(jax.random.key(0), (4, 3))

    def volume(corners):
        edges = corners[1:] - corners[0]
        return jnp.linalg.det(edges) / 6

    slope = jax.grad(volume)(corners)
    edges = (corners[1:] - corners[0])[:, None]
    mine = [
        constraints.volume_slope(edges[1], edges[2])[0],
        constraints.volume_slope(edges[2], edges[0])[0],
        constraints.volume_slope(edges[0], edges[1])[0],
    ]
    np.testing.assert_allclose(mine, slope[1:], rtol=1e-4, atol=1e-5)


def test_springs_neither_push_nor_turn_a_body_that_nothing_holds():
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(6, 3)) * 0.1
    pairs = [(i, j) for i in range(6) for j in range(i)]
    body = springs(positions, pairs, air=Air(drag=0.0))
    velocities = rng.normal(size=(6, 3))
    path, speeds = play(body, velocities=velocities, steps=400)
    fall = 9.81 * np.arange(1, 31) / 30
    momentum = speeds.sum(axis=1) + 6 * np.array([0, 0, 1.0]) * fall[:, None]
    np.testing.assert_allclose(
        momentum, np.broadcast_to(velocities.sum(axis=0), momentum.shape), atol=1e-6
    )
    centred = path - path.mean(axis=1, keepdims=True)
    spin = np.cross(centred, speeds).sum(axis=1)
    at_first = np.cross(positions - positions.mean(axis=0), velocities).sum(axis=0)
    np.testing.assert_allclose(
        spin, np.broadcast_to(at_first, spin.shape), atol=0.02 * np.abs(at_first).max()
    )


def test_a_weight_on_a_spring_swings_as_it_should_the_nearer_the_smaller_the_steps():
    """A mass m on a spring k falls from its unstretched length: z = -(m g / k) (1 - cos ωt)."""
    body = springs([[0, 0, 0], [0, 0, -1]], [(0, 1)], pins=[0])
    time = np.arange(1, 31) / 30
    exact = -1 - 0.1 * 9.81 / 10 * (1 - np.cos(np.sqrt(10 / 0.1) * time))
    errors = []
    for steps in (50, 100, 200):
        path, _ = play(body, steps=steps)
        errors.append(np.abs(path[:, 1, 2] - exact).max())
    ratios = np.divide(errors[:-1], errors[1:])
    np.testing.assert_allclose(ratios, 2, atol=0.2)


def test_bodies_side_by_side_move_as_each_does_alone():
    body = cloth(air=Air(drag=0.5, density=1.0, wind=(0, 3.0, 0)), capsules=(ball(0.1),))
    frames = 10
    rng = np.random.default_rng(1)
    centres = np.cumsum(rng.normal(size=(frames + 1, 3, LANES)) * 0.02, axis=0)
    centres += np.array([0.25, 0.12, -0.25])[None, :, None]
    movers = poses_of(beside_the_world(centres))
    still = np.zeros_like(body.positions)
    spread = [np.repeat(part[..., None], LANES, axis=-1) for part in (body.positions, still)]
    together, _ = SoftProgram(body, LANES).play(*spread, movers, 1 / 30, 20)
    for lane in (0, LANES - 1):
        alone, _ = SoftProgram(body).play(body.positions, still, movers[..., lane], 1 / 30, 20)
        np.testing.assert_allclose(together[..., lane], alone, atol=2e-4)


def test_nothing_is_inside_a_collider_and_pins_stay_where_they_are_held():
    body = cloth(capsules=(ball(0.12),), margin=0.005)
    frames = 30
    height = np.linspace(-0.8, -0.2, frames + 1)
    centres = np.stack([0.25 + 0 * height, 0.02 + 0 * height, height], axis=1)
    path, _ = play(body, movers=beside_the_world(centres))
    free = np.setdiff1d(np.arange(64), body.pins)
    distance = np.linalg.norm(path[:, free] - centres[1:, None], axis=2)
    assert distance.min() > 0.12 + 0.005 - 1e-6
    assert (path[:, body.pins] == body.positions[body.pins]).all()
    assert np.abs(path[-1, :, 1]).max() > 0.05  # it was struck


@pytest.mark.parametrize(("slope", "is_held"), [(0.3, True), (0.6, False)])
def test_friction_holds_on_a_slope_that_is_less_steep_than_it_is_strong(slope, is_held):
    angle = np.arctan(slope)
    normal = (-np.sin(angle), 0.0, np.cos(angle))
    body = springs([[0.0, 0, 0]], [], planes=(MovingPlane(normal, friction=0.45),))
    path, _ = play(body, steps=40)
    if is_held:
        assert np.abs(path[-1]).max() < 1e-3
        return
    along = np.cos(angle) * 9.81 * (slope - 0.45)
    np.testing.assert_allclose(np.linalg.norm(path[-1]), along / 2, rtol=0.05)


def test_a_solid_keeps_its_volume_where_it_lies():
    corners = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.1) for z in (0.0, 0.1)])
    tetrahedra = np.array([[0, 1, 2, 4], [1, 2, 4, 7], [1, 2, 3, 7], [1, 4, 5, 7], [2, 4, 6, 7]])
    volumes = tetrahedron_volumes(corners, tetrahedra)
    tetrahedra[volumes < 0] = tetrahedra[volumes < 0][:, [1, 0, 2, 3]]
    pairs = [(i, j) for i in range(8) for j in range(i)]
    body = springs(
        corners,
        pairs,
        stiffness=60.0,
        tetrahedra=tetrahedra,
        bulk_stiffness=np.full(5, 1e12),
        planes=(MovingPlane(),),
        air=Air(drag=2.0),
    )
    path, _ = play(body, frames=60, steps=40)
    whole = tetrahedron_volumes(path[-1], body.tetrahedra).sum()
    assert whole == pytest.approx(1e-3, rel=1e-3)
    assert np.ptp(path[-1][:, 2]) < 0.099  # it sags
    assert path[-1][:, 2].min() > -1e-6


def test_springs_of_one_colour_share_no_node():
    body = cloth()
    for first, last in zip(body.pair_colours[:-1], body.pair_colours[1:], strict=True):
        nodes = body.pairs[first:last].ravel()
        assert len(set(nodes.tolist())) == len(nodes)


def test_wind_blows_a_cloth_along_and_leaves_it_alone_edge_on():
    aside = replace(cloth(), air=Air(drag=0.0, density=1.2, wind=(0.0, 4.0, 0.0)))
    edge_on = replace(cloth(), air=Air(drag=0.0, density=1.2, wind=(4.0, 0.0, 0.0)))
    assert play(aside)[0][-1, :, 1].max() > 0.01
    assert np.abs(play(edge_on)[0][-1, :, 1]).max() < 1e-9


def test_a_cloth_in_the_wind_moves_as_one_carried_through_still_air():
    """Each of several side by side has a wind of its own."""
    winds = np.random.default_rng(0).uniform(-4, 4, (3, LANES))
    body = replace(cloth(), air=Air(drag=0.5, density=1.2, wind=(1.0, 1.0, 1.0)))
    still = np.repeat(0 * body.positions[..., None], LANES, axis=-1)
    places = np.repeat(body.positions[..., None], LANES, axis=-1)
    times = np.arange(21) / 30
    movers = np.zeros((21, 1, 4, LANES))
    carried = movers.copy()
    carried[:, 0, :3] = -times[:, None, None] * winds
    program = SoftProgram(body, LANES, np.float64)
    here, _ = program.play(places, still, poses_of(movers), 1 / 30, 20, winds)
    there, _ = program.play(places, still - winds, poses_of(carried), 1 / 30, 20, 0 * winds)
    np.testing.assert_allclose(there + times[1:, None, None, None] * winds, here, atol=1e-9)
