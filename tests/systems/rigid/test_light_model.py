"""Models too large for an emulator file: textures and corners go, the physics stays."""

from __future__ import annotations

import struct
from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator.errors import BadFileError
from neuroanimator.parsing.json_text import MAX_DEFINITION
from neuroanimator.storage.files import canonical_json
from neuroanimator.systems.rigid.model_files import compile_model, read_model

TRIANGLES = 8_000

BODIES = """
  <body name="base" pos="0 0 1"><freejoint/>
    <geom type="mesh" mesh="rock" {solid}/>
    <geom type="mesh" mesh="paint" contype="0" conaffinity="0" mass="0" material="wood"/>
    <body name="arm" pos="0.5 0 0"><joint name="j" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="0.3" diaginertia="0.01 0.01 0.01"/>
      <geom type="mesh" mesh="rock" euler="20 30 0"/></body>
  </body>"""

ROCK = """<mujoco><option timestep="0.002"/><compiler meshdir="meshes"/>
  <asset>
    <mesh name="rock" file="rock.stl" scale="0.4 0.3 0.2"/>
    <mesh name="paint" file="paint.stl" scale="0.5 0.5 0.5"/>
    <texture name="wood" type="2d" file="wood.png"/><material name="wood" texture="wood" rgba="0.5 1 1 1"/>
  </asset>
  <worldbody><geom name="floor" type="plane" size="5 5 1"/>{bodies}</worldbody>
  <actuator><motor name="j" joint="j" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""


def bumpy_ball(seed: int) -> bytes:
    """Return an STL of triangles that do not join, with corners in and on a ball of radius 1."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(TRIANGLES, 3, 3))
    corners /= np.linalg.norm(corners, axis=-1, keepdims=True)
    corners *= rng.uniform(0.2, 1.0, (TRIANGLES, 3, 1)) ** 0.2
    faces = [struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in corners]
    return bytes(80) + struct.pack("<I", TRIANGLES) + b"".join(faces)


def large_model(folder: Path, bodies: str = BODIES, solid: str = "") -> Path:
    (folder / "meshes").mkdir()
    (folder / "rock.xml").write_text(ROCK.format(bodies=bodies.format(solid=solid)))
    (folder / "meshes" / "rock.stl").write_bytes(bumpy_ball(0))
    (folder / "meshes" / "paint.stl").write_bytes(bumpy_ball(1))
    (folder / "wood.png").write_bytes(b"no picture at all")
    return folder / "rock.xml"


def whole_model(path: Path) -> mujoco.MjModel:
    """Return the model with all of its meshes, its textures taken out."""
    text = path.read_text()
    for part in ('<texture name="wood" type="2d" file="wood.png"/>', ' texture="wood"'):
        text = text.replace(part, "")
    (path.parent / "whole.xml").write_text(text)
    return mujoco.MjModel.from_xml_path(str(path.parent / "whole.xml"))


def contacts_of(model: mujoco.MjModel, seed: int) -> np.ndarray:
    """Return the depth, place and normal of the deepest contact in a random pose, as seven numbers."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    data.qpos[:3] = [0, 0, 0.1]
    data.qpos[3:7] = rng.normal(size=4)
    data.qpos[7] = rng.uniform(-3, 3)
    mujoco.mj_forward(model, data)
    contact = data.contact[int(np.argmin(data.contact.dist))]
    return np.concatenate([[contact.dist], contact.pos, contact.frame[:3]])


def test_a_large_model_keeps_its_masses_and_its_contacts(tmp_path: Path):
    path = large_model(tmp_path)
    read = read_model(path)
    assert len(canonical_json(read.files.to_json())) < MAX_DEFINITION
    assert read.note == (
        "textures left out: 1; meshes that touch nothing, drawn as boxes: 1; "
        "meshes that collide, kept as their convex hulls: 1"
    )
    light = compile_model(read.files)
    whole = whole_model(path)
    np.testing.assert_allclose(light.body_mass, whole.body_mass, rtol=1e-6)
    np.testing.assert_allclose(light.body_inertia[2], whole.body_inertia[2], rtol=1e-6)
    np.testing.assert_allclose(
        np.sort(light.body_inertia[1]), np.sort(whole.body_inertia[1]), rtol=1e-6
    )
    np.testing.assert_allclose(light.body_ipos, whole.body_ipos, atol=1e-6)
    for seed in range(30):
        np.testing.assert_allclose(contacts_of(light, seed), contacts_of(whole, seed), atol=2e-4)


def test_what_is_drawn_stays_where_it_was(tmp_path: Path):
    path = large_model(tmp_path)
    light = compile_model(read_model(path).files)
    whole = whole_model(path)
    for model in (light, whole):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        corners = []
        for geom in range(1, model.ngeom):
            mesh = model.geom_dataid[geom]
            first = model.mesh_vertadr[mesh]
            vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
            placed = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            corners.append([placed.min(axis=0), placed.max(axis=0)])
        if model is light:
            of_light = np.array(corners)
    np.testing.assert_allclose(of_light, corners, atol=1e-6)
    assert light.mat_rgba.tolist() == [[0.5, 1, 1, 1]]


def test_a_model_is_made_light_the_same_way_every_time(tmp_path: Path):
    path = large_model(tmp_path)
    assert read_model(path) == read_model(path)


def test_a_urdf_is_made_light_too(tmp_path: Path):
    inertia = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    shape = '<collision><geometry><mesh filename="package://r/rock.stl" scale="{}"/></geometry></collision>'
    (tmp_path / "r.urdf").write_text(
        f'<robot name="r"><link name="a">{inertia}{shape.format("1 2 3")}</link>'
        f'<link name="b">{inertia}{shape.format("1 1 1")}{shape.format("1 2 3")}</link>'
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    (tmp_path / "rock.stl").write_bytes(bumpy_ball(0))
    read = read_model(tmp_path / "r.urdf")
    assert read.note == "meshes that collide, kept as their convex hulls: 3"
    model = compile_model(read.files)
    assert model.body_mass[1] == 1
    aabb = np.sort(model.geom_aabb[:, 3:], axis=1)
    np.testing.assert_allclose(aabb, [[1, 2, 3], [1, 1, 1], [1, 2, 3]], rtol=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda bodies: bodies.replace('name="base" ', ""), "body '1': its mass comes from a mesh"),
        (
            lambda bodies: bodies.replace(
                "<freejoint/>", '<freejoint/><geom type="box" mesh="rock"/>'
            ),
            "its size comes from a mesh",
        ),
    ],
)
def test_what_would_change_the_physics_is_refused_by_name(change, message: str, tmp_path: Path):
    with pytest.raises(BadFileError, match=message):
        read_model(large_model(tmp_path, change(BODIES)))
