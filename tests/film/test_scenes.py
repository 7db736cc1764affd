"""Scenes of films: a floor under what would hang in an empty sky, and nothing that casts shadows on itself."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from soft_bodies import soft_clip, wavy_shapes

from neuroanimator import Clip, load_system
from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.film.bounding_boxes import bounding_boxes
from neuroanimator.film.camera import take_shots
from neuroanimator.film.graphics import graphics_backend
from neuroanimator.film.options import Film, Take
from neuroanimator.film.rigid_scene import STAND_COLOUR, RigidScene, lacks_ground
from neuroanimator.film.skeleton_scene import SkeletonScene
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem


def rigid(name: str) -> MujocoSystem:
    system = load_system(name)
    assert isinstance(system, MujocoSystem)
    return system


def still(name: str, frames: int = 2) -> Clip:
    system = rigid(name)
    states = np.repeat(system.rest[None], frames, axis=0)
    return Clip(name, system.skeleton, np.arange(frames) / 30, states)


def filled(scene: RigidScene) -> mujoco.MjvScene:
    """Return what is drawn of a scene."""
    picture = mujoco.MjvScene(scene.model, 1000)
    options = (mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.MjvCamera())
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(scene.model, scene.data, *options, everything, picture)
    scene.fill(picture)
    return picture


def shapes(picture: mujoco.MjvScene, kind: mujoco.mjtGeom) -> list[mujoco.MjvGeom]:
    every = [picture.geoms[number] for number in range(picture.ngeom)]
    return [geom for geom in every if geom.type == kind]


def rods_of(picture: mujoco.MjvScene) -> list[mujoco.MjvGeom]:
    """Return the parts of a stand."""
    cylinders = shapes(picture, mujoco.mjtGeom.mjGEOM_CYLINDER)
    return [geom for geom in cylinders if np.allclose(geom.rgba, STAND_COLOUR)]


@pytest.mark.parametrize("name", ["pendulum", "truck", "lander"])
def test_there_is_one_floor_under_all_that_moves_and_it_casts_no_shadow(name: str):
    clip = still(name)
    take = Take((clip,))
    shots = take_shots(take, Film())
    scene = RigidScene(rigid(name), take, shots)
    assert lacks_ground(scene.model, shots.size) == (name == "pendulum")
    scene.pose([clip.states[0]])
    picture = filled(scene)
    (floor,) = shapes(picture, mujoco.mjtGeom.mjGEOM_PLANE)
    assert floor.pos[2] < bounding_boxes([clip]).low[:, 2].min() + 0.1
    assert floor.category == mujoco.mjtCatBit.mjCAT_DECOR
    assert len(rods_of(picture)) == (3 if name == "pendulum" else 0)
    moving = [geom for geom in shapes(picture, mujoco.mjtGeom.mjGEOM_CAPSULE) if geom.objid >= 0]
    assert all(geom.category != mujoco.mjtCatBit.mjCAT_DECOR for geom in moving)


@pytest.mark.parametrize("name", SHIPPED_SYSTEMS)
def test_only_swimmers_are_in_water_and_all_others_stand_on_the_ground(name: str):
    system = load_system(name)
    if isinstance(system, MujocoSystem):
        return
    states = np.repeat(np.asarray(system.rest)[None], 2, axis=0)
    take = Take((Clip(name, system.skeleton, np.arange(2.0), states),))
    shots = take_shots(take, Film(), system.water_surface)
    model = SkeletonScene(take, shots, system).model
    fog = model.vis.rgba.fog[:3]
    is_blue = fog[2] > 1.3 * fog[0]
    assert is_blue == (name in ("fish", "fishes", "trout", "orca", "dolphin"))
    (floor,) = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    depth = bounding_boxes(take.clips).low[:, 2].min() - model.geom_pos[floor, 2]
    assert is_blue or depth < 0.1 * shots.size


def test_the_stand_of_a_pendulum_holds_its_hinge_and_reaches_the_floor():
    clip = still("pendulum")
    shots = take_shots(Take((clip,)), Film())
    scene = RigidScene(rigid("pendulum"), Take((clip,)), shots)
    scene.pose([clip.states[0]])
    picture = filled(scene)
    (floor,) = shapes(picture, mujoco.mjtGeom.mjGEOM_PLANE)
    ends = []
    for rod in rods_of(picture):
        along = np.array(rod.mat)[:, 2] * rod.size[2]
        ends += [np.array(rod.pos) - along, np.array(rod.pos) + along]
    assert min(np.linalg.norm(end - scene.data.xanchor[0]) for end in ends) < 1e-3
    assert abs(min(end[2] for end in ends) - floor.pos[2]) < 1e-3


def test_the_model_that_physics_runs_on_is_left_alone():
    system = rigid("pendulum")
    before = system.model.light_type.copy()
    take = Take((still("pendulum"),))
    RigidScene(system, take, take_shots(take, Film()))
    assert (system.model.light_type == before).all()


def test_a_ghost_is_the_body_in_another_place_and_colour():
    clip = still("pendulum")
    elsewhere = Clip(clip.name, clip.skeleton, clip.times, clip.states + 0.5)
    take = Take((clip,), elsewhere)
    scene = RigidScene(rigid("pendulum"), take, take_shots(take, Film()))
    scene.pose([clip.states[0], elsewhere.states[0]])
    links = shapes(filled(scene), mujoco.mjtGeom.mjGEOM_CAPSULE)
    bodies = [geom for geom in links if geom.rgba[3] == 1]
    ghosts = [geom for geom in links if geom.rgba[3] < 1]
    assert len(bodies) == len(ghosts) == 3
    for body, ghost in zip(bodies, ghosts, strict=True):
        assert np.abs(np.array(body.pos) - ghost.pos).max() > 0.05


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
