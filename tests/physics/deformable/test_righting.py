"""Bodies in water know up from down: lift above weight turns them belly down, and keels keep them from swinging."""

from __future__ import annotations

import numpy as np
import pytest

from neuroanimator import load_system
from neuroanimator.physics.deformable.body import Body, Ground
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.water import Water
from neuroanimator.state.rotation import to_world_axes, upward

BODIES = ("dolphin", "fish")


def deformable(name: str) -> DeformableSystem:
    system = load_system(name)
    assert isinstance(system, DeformableSystem)
    return system


def tilt(system: DeformableSystem, states: np.ndarray) -> np.ndarray:
    """Return the angle [degrees] between a body's up and the world's, of states (..., S)."""
    cloud = system.structure.cloud
    assert cloud is not None
    return np.degrees(
        np.arccos(np.clip(upward(cloud.orientation(system.unpack(states)[0]))[..., 2], -1, 1))
    )


def rolled(system: DeformableSystem, angle: float) -> np.ndarray:
    """Return the body at rest (S,), rolled by `angle` [rad]."""
    cloud = system.structure.cloud
    assert cloud is not None
    positions, velocities, activations = system.unpack(system.rest)
    centre = cloud.centroid(positions)
    orientation = np.array([np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0])
    return system.pack(
        centre + to_world_axes(orientation, positions - centre), velocities, activations
    )


@pytest.mark.parametrize("name", BODIES)
def test_lift_carries_the_weight_and_its_centre_lies_above_that_of_mass(name: str):
    body = deformable(name).body
    assert body.water is not None
    centred = body.positions - body.masses @ body.positions / body.masses.sum()
    lifted = body.masses * body.lift
    assert lifted.sum() == pytest.approx(body.masses.sum() * body.water.buoyancy)
    np.testing.assert_allclose(
        lifted @ centred / lifted.sum(), [0, 0, body.water.righting], atol=1e-12
    )
    assert (body.lift > 0).all()


@pytest.mark.parametrize(("name", "seconds"), [("dolphin", 10.0), ("fish", 5.0)])
def test_belly_up_a_body_turns_over_and_stays(name: str, seconds: float):
    system = deformable(name)
    dt = 50 * system.physics_dt
    starts = np.stack([rolled(system, angle) for angle in (3.0, -1.5)])
    controls = np.zeros((2, round(1.4 * seconds / dt), system.control.size))
    tilts = tilt(system, system.simulate_fastest(starts, controls, dt).states)
    assert (tilts[:, 0] > 80).all()
    assert tilts[:, round(seconds / dt) :].max() < 10


@pytest.mark.parametrize("name", BODIES)
def test_swimming_along_a_body_stays_upright_and_level(name: str):
    system = deformable(name)
    dt = 50 * system.physics_dt
    assert system.gait is not None
    controls = system.gait.controls(round(6 / dt), dt, system.bounds)[None]
    states = system.simulate_fastest(system.rest[None], controls, dt).states
    cloud = system.structure.cloud
    assert cloud is not None
    path = cloud.centroid(system.unpack(states)[0])[0]
    assert tilt(system, states).max() < 20
    assert path[-1, 0] - path[0, 0] > 2 * np.ptp(system.body.positions[:, 0])
    assert np.abs(path[:, 2] - path[0, 2]).max() < 0.3 * np.ptp(system.body.positions[:, 0])


def bar(water: Water | None, ground: Ground | None, rest_height: float) -> Body:
    """Return three mass points in a triangle, in SI units of order one."""
    return Body(
        names=("a", "b", "c"),
        positions=np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.0, 0.8]]),
        masses=np.array([1.0, 1.0, 2.0]),
        springs=np.array([[0, 1], [1, 2], [2, 0]]),
        stiffness=np.full(3, 500.0),
        damping=np.zeros(3),
        muscles=np.zeros((3, 0)),
        external_forces=np.zeros((3, 0)),
        faces=np.zeros((0, 4), int),
        water=water,
        ground=ground,
        rest_height=rest_height,
    )


def test_springs_are_stretched_only_where_the_body_is_carried():
    falling = bar(None, None, 0.0)
    floating = bar(Water(face_drag=0.0, righting=0.1), None, 0.0)
    too_deep = bar(None, Ground(1000.0, 0.0, 0.5, 0.1), -0.5)
    carried = bar(None, Ground(1000.0, 0.0, 0.5, 0.1), -4.0 * 9.81 / 2000)
    for body in (falling, too_deep):
        assert np.array_equal(body.lengths, body.spans)
    for body in (floating, carried):
        assert np.abs(body.lengths - body.spans).max() > 1e-4
