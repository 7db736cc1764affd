"""What films add to bodies: a floor under what would hang in an empty sky, and water that splashes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from neuroanimator import Clip, load_system
from neuroanimator.export.film.bounding_boxes import bounding_boxes
from neuroanimator.export.film.options import Film
from neuroanimator.export.film.rigid_scene import RigidScene
from neuroanimator.export.film.splashes import FOAM_SECONDS, HEIGHT, Splashes
from neuroanimator.export.film.studio_floor import lacks_ground
from neuroanimator.export.film.takes import Take
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem

RATE = 30.0


def rigid(name: str) -> MujocoSystem:
    system = load_system(name)
    assert isinstance(system, MujocoSystem)
    return system


def empty_scene(most: int = 2000) -> mujoco.MjvScene:
    return mujoco.MjvScene(mujoco.MjModel.from_xml_string("<mujoco/>"), most)


def shapes(scene: mujoco.MjvScene, kind: mujoco.mjtGeom) -> list[mujoco.MjvGeom]:
    return [scene.geoms[n] for n in range(scene.ngeom) if scene.geoms[n].type == kind]


def falling(speed: float) -> np.ndarray:
    """Return the positions (60, 1, 3) of a point that goes down through the surface at 0.5 s."""
    times = np.arange(60) / RATE
    return np.stack([2 * times, 0 * times, speed * (0.5 - times)], axis=1)[:, None]


@pytest.mark.parametrize(
    ("name", "lacks"), [("pendulum", True), ("truck", False), ("lander", False)]
)
def test_what_has_no_ground_gets_a_floor_under_all_that_it_does(name: str, lacks: bool):
    system = rigid(name)
    states = np.repeat(system.rest[None], 30, axis=0)
    states[:, 0] = np.linspace(0, 2, 30)
    clip = Clip(name, system.skeleton, np.arange(30) / RATE, states)
    film = RigidScene(system, Take((clip,)), Film())
    assert lacks_ground(system.model, film.shots.size) == lacks
    scene = empty_scene()
    film.prepare(scene)
    film.pose(0)
    film.fill(scene)
    planes = shapes(scene, mujoco.mjtGeom.mjGEOM_PLANE)
    assert bool(planes) == lacks
    for plane in planes:
        assert plane.pos[2] < bounding_boxes([clip]).low[:, 2].min()
        assert plane.category == mujoco.mjtCatBit.mjCAT_DECOR
    assert bool(scene.flags[mujoco.mjtRndFlag.mjRND_FOG]) == lacks
    # What hangs from nothing hangs from a stand, which is behind it.
    stand = shapes(scene, mujoco.mjtGeom.mjGEOM_CAPSULE)
    assert len(stand) == 2 * lacks
    for part in stand:
        beyond = np.array(part.pos) - film.shots.position[0]
        assert np.linalg.norm(beyond) > np.linalg.norm(film.shots.position[0])


def test_the_model_that_physics_runs_on_is_left_alone():
    system = rigid("pendulum")
    before = system.model.light_type.copy()
    states = np.repeat(system.rest[None], 2, axis=0)
    RigidScene(
        system, Take((Clip("pendulum", system.skeleton, np.arange(2) / RATE, states),)), Film()
    )
    assert (system.model.light_type == before).all()


def test_drops_rise_where_something_falls_in_and_come_down_again():
    splashes = Splashes(falling(8.0), RATE, 0.0, 2.0)
    heights = []
    for frame in range(60):
        scene = empty_scene()
        splashes.fill(scene, frame)
        drops = shapes(scene, mujoco.mjtGeom.mjGEOM_BOX)
        highest = max((float(drop.pos[2]) for drop in drops), default=0.0)
        heights.append(highest)
        for drop in drops:
            assert abs(drop.pos[0] - 1.0) < 2.0
    assert max(heights[:15]) == 0
    assert 0.1 < max(heights) < HEIGHT * 2.0
    assert heights[-1] == 0


def test_foam_spreads_and_has_gone_after_a_second():
    splashes = Splashes(falling(8.0), RATE, 0.0, 2.0)
    radii = []
    for frame in range(16, 60):
        scene = empty_scene()
        splashes.fill(scene, frame)
        foam = shapes(scene, mujoco.mjtGeom.mjGEOM_ELLIPSOID)
        if frame / RATE < 0.5 + FOAM_SECONDS:
            (patch,) = foam
            radii.append(float(patch.size[0]))
        else:
            assert not foam
    assert (np.diff(radii) > 0).all()


def test_what_glides_through_the_surface_splashes_nothing():
    splashes = Splashes(falling(0.5), RATE, 0.0, 2.0)
    scene = empty_scene()
    for frame in range(60):
        splashes.fill(scene, frame)
    assert scene.ngeom == 0


def test_a_full_picture_is_no_error():
    splashes = Splashes(falling(8.0), RATE, 0.0, 2.0)
    scene = empty_scene(3)
    splashes.fill(scene, 20)
    assert scene.ngeom == 3


def test_the_ground_casts_no_shadow_on_itself():
    system = rigid("lander")
    states = np.repeat(system.rest[None], 2, axis=0)
    take = Take((Clip("lander", system.skeleton, np.arange(2) / RATE, states),))
    film = RigidScene(system, take, Film())
    film.pose(0)
    scene = mujoco.MjvScene(film.model, 1000)
    options = (mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.MjvCamera())
    mujoco.mjv_updateScene(film.model, film.data, *options, mujoco.mjtCatBit.mjCAT_ALL, scene)
    film.fill(scene)
    (ground,) = shapes(scene, mujoco.mjtGeom.mjGEOM_PLANE)
    assert ground.category == mujoco.mjtCatBit.mjCAT_DECOR
    hull = shapes(scene, mujoco.mjtGeom.mjGEOM_ELLIPSOID)
    assert all(geom.category == mujoco.mjtCatBit.mjCAT_DYNAMIC for geom in hull)
