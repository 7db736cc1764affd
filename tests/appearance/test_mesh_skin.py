"""The skin of a MuJoCo model goes with its bones as MuJoCo has it, in an emulator's file, in a film and in a GLB."""

from __future__ import annotations

import base64
import functools
import json
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import accessor, read_glb

from neuroanimator import Clip, write_glb, write_usd
from neuroanimator.appearance.mesh_skin import MAX_VERTICES, PACKED, MeshSkin
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin_mesh import colours_of, parts_of, skin_mesh
from neuroanimator.film.bounding_boxes import bounding_boxes
from neuroanimator.physics.rigid.bones import skeleton_of
from neuroanimator.physics.rigid.skins import skin_of
from neuroanimator.state.rotation import rotation_matrices

HUMAN = Path(__file__).parents[2] / "examples" / "human" / "human.xml"
UP_TO_Y = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
"""What takes Z up to Y up."""


@functools.cache
def human() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(HUMAN))


@functools.cache
def skeleton() -> Skeleton:
    return skeleton_of(human())


def mesh_skin() -> MeshSkin:
    skin = skeleton().skin
    assert isinstance(skin, MeshSkin)
    return skin


def poses(count: int) -> np.ndarray:
    """Return random positions (T, nq) of the human's joints."""
    model = human()
    rng = np.random.default_rng(0)
    positions = np.tile(model.qpos0, (count, 1))
    positions += rng.normal(size=positions.shape) * 0.5
    for position in positions:
        mujoco.mj_normalizeQuat(model, position)
    return positions


def as_mujoco_has_it(positions: np.ndarray) -> np.ndarray:
    """Return where MuJoCo draws the vertices of all skins (V, 3)."""
    model = human()
    data = mujoco.MjData(model)
    data.qpos[:] = positions
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, 1000)
    every = int(mujoco.mjtCatBit.mjCAT_ALL)
    options = (mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.MjvCamera())
    mujoco.mjv_updateScene(model, data, *options, every, scene)
    return np.array(scene.skinvert).reshape(-1, 3)


def blended(matrices: np.ndarray, bones: np.ndarray, weights: np.ndarray, points: np.ndarray):
    """Return points (V, 3) that follow `bones` (V, 4), moved by `matrices` (B, 4, 4), as much as `weights` say."""
    whole = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    followed = np.einsum("vbij,vj->vbi", matrices[bones], whole)
    return (followed * weights[..., None]).sum(axis=1)[:, :3]


def transforms(positions: np.ndarray, orientations: np.ndarray) -> np.ndarray:
    matrices = np.tile(np.eye(4), (len(positions), 1, 1))
    matrices[:, :3, :3] = rotation_matrices(orientations)
    matrices[:, :3, 3] = positions
    return matrices


def test_the_skin_is_as_mujoco_has_it_whatever_the_pose():
    mesh = skin_mesh(skeleton())
    bind = transforms(mesh.bind_positions, mesh.bind_orientations)
    for state in poses(2):
        positions, orientations = skeleton().world_poses(state[None])
        matrices = transforms(positions[0], orientations[0]) @ np.linalg.inv(bind)
        here = blended(matrices, mesh.bones, mesh.weights, mesh.points)
        np.testing.assert_allclose(here, as_mujoco_has_it(state), atol=1e-5)


def test_in_its_bind_pose_the_skin_is_as_it_was_made_and_follows_one_bone_rigidly():
    mesh = skin_mesh(skeleton())
    np.testing.assert_allclose(mesh.points, human().skin_vert, atol=1e-7)
    np.testing.assert_allclose(mesh.weights.sum(axis=1), 1)
    rigid = mesh.weights.max(axis=1) == 1
    assert 0.3 < rigid.mean() < 0.9
    first, second = (as_mujoco_has_it(pose)[rigid] for pose in poses(2))
    main = mesh.bones[rigid, mesh.weights[rigid].argmax(axis=1)]
    for bone in np.unique(main):
        own = main == bone
        distances = [
            np.linalg.norm(points[own] - points[own][0], axis=1) for points in (first, second)
        ]
        np.testing.assert_allclose(*distances, atol=1e-5)


def test_a_viewer_of_the_glb_puts_the_skin_where_mujoco_has_it(tmp_path: Path):
    states = poses(2)
    write_glb(Clip("human", skeleton(), np.arange(2) / 30, states), tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    (skin,) = document["skins"]
    primitives = document["meshes"][-1]["primitives"]
    attributes = {
        name: accessor(document, binary, number)
        for name, number in primitives[0]["attributes"].items()
    }
    assert "COLOR_0" not in attributes
    joints = world_matrices(document, binary, 1)[skin["joints"]]
    inverse = accessor(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4)
    matrices = joints @ inverse.transpose(0, 2, 1)
    points = blended(
        matrices, attributes["JOINTS_0"], attributes["WEIGHTS_0"], attributes["POSITION"]
    )
    np.testing.assert_allclose(points, as_mujoco_has_it(states[1]) @ UP_TO_Y.T, atol=1e-5)
    names = [document["materials"][one["material"]]["name"] for one in primitives]
    assert names == [part.name for part in mesh_skin().parts]


def world_matrices(document: dict[str, Any], binary: bytes, frame: int) -> np.ndarray:
    """Return where nodes are in a frame, by the rules of glTF alone."""
    matrices = []
    for node in document["nodes"]:
        place = np.array(node.get("translation", [0, 0, 0]), float)
        turn = np.array(node.get("rotation", [0, 0, 0, 1]), float)
        matrices.append(transforms(place[None], turn[None, [3, 0, 1, 2]])[0])
    animation = document["animations"][0]
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        value = accessor(document, binary, sampler["output"])[frame].astype(float)
        matrix = matrices[channel["target"]["node"]]
        if channel["target"]["path"] == "translation":
            matrix[:3, 3] = value
        else:
            matrix[:3, :3] = rotation_matrices(value[[3, 0, 1, 2]])
    # Parents come before their children.
    for number, node in enumerate(document["nodes"]):
        for child in node.get("children", []):
            assert child > number
            matrices[child] = matrices[number] @ matrices[child]
    return np.array(matrices)


def test_the_skin_changes_nothing_of_the_physics():
    text = HUMAN.read_text().replace('  <include file="skin/skin.xml"/>\n', "")
    assert text != HUMAN.read_text()
    bare = mujoco.MjModel.from_xml_string(text)
    assert bare.nskin == 0
    assert human().nskin > 0
    trajectories = []
    for model in (bare, human()):
        data = mujoco.MjData(model)
        data.qpos[:] = poses(1)[0]
        data.qpos[2] = 1.2
        data.ctrl[:] = 0.3
        mujoco.mj_step(model, data, 200)
        trajectories.append(np.concatenate([data.qpos, data.qvel, [data.ncon]]))
    np.testing.assert_array_equal(*trajectories)


def test_a_skin_is_the_same_after_a_file_and_after_it_is_made_again():
    skin = mesh_skin()
    again = Skeleton.from_json(json.loads(json.dumps(skeleton().to_json())), human().nq)
    assert again == skeleton()
    assert MeshSkin.of(skin.arrays, skin.bones, skin.parts) == skin


def test_a_skin_whose_arrays_are_not_packed_is_read_as_older_files_have_it():
    described = json.loads(json.dumps(skeleton().to_json()))
    for name in ("vertices", "triangles", "influences", "weights"):
        packed = described["skin"][name]
        plain = base64.b64encode(getattr(mesh_skin(), name)).decode()
        assert packed.startswith(PACKED)
        assert len(packed) < len(plain)
        described["skin"][name] = plain
    assert Skeleton.from_json(described, human().nq) == skeleton()


def test_every_triangle_is_of_one_part_in_its_colour():
    skin = mesh_skin()
    mesh = skin_mesh(skeleton())
    parts = parts_of(skin, mesh)
    assert sorted(np.concatenate(list(parts.values()))) == list(range(len(mesh.triangles)))
    colours = colours_of(skin, mesh.shades)
    for part in skin.parts:
        corners = mesh.triangles[parts[part.name]]
        np.testing.assert_allclose(
            colours[corners], np.broadcast_to(part.colour, (*corners.shape, 3))
        )


def test_the_camera_sees_all_of_the_skin():
    states = poses(3)
    boxes = bounding_boxes([Clip("human", skeleton(), np.arange(3) / 30, states)])
    for low, high, state in zip(boxes.low, boxes.high, states, strict=True):
        points = as_mujoco_has_it(state)
        assert (points > low - 0.02).all()
        assert (points < high + 0.02).all()
        assert (high - low < np.ptp(points, axis=0) + 0.3).all()


def coded(byte: int, size: int, vertices: int | None = None) -> str:
    """Return an array of that many bytes a vertex, all of them `byte`; as many vertices as the human has, or others."""
    if vertices is None:
        vertices = len(mesh_skin().arrays.vertices)
    return base64.b64encode(bytes([byte]) * (size * vertices)).decode()


def packed(content: bytes, after: bytes = b"") -> str:
    return PACKED + base64.b64encode(zlib.compress(content, 9) + after).decode()


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda skin: skin.update(triangles="/" * 8), "parts do not cover all"),
        (lambda skin: skin.update(triangles=packed(bytes(6))), "parts do not cover all"),
        (lambda skin: skin.update(triangles=skin["triangles"][:-8]), "truncated"),
        (lambda skin: skin.update(triangles=packed(bytes(6), b"x")), "truncated"),
        (lambda skin: skin.update(triangles=packed(bytes(10**7))), "larger than 120,000 bytes"),
        (lambda skin: skin.update(triangles=PACKED + "AAAA"), "damaged"),
        (lambda skin: skin.update(triangles=PACKED), "truncated"),
        (lambda skin: skin.update(triangles=[0, 1, 2]), "not text"),
        (lambda skin: skin.update(triangles="A"), "not base64"),
        (lambda skin: skin.update(weights=coded(255, 3, 1)), "truncated"),
        (lambda skin: skin.update(weights=coded(255, 4, 1)), "four weights"),
        (lambda skin: skin.update(weights=coded(255, 4)), "do not add up"),
        (lambda skin: skin.update(influences=coded(255, 4)), "follows a bone"),
        (lambda skin: skin.update(vertices=coded(0, 6, 3)), "four bones"),
        (lambda skin: skin.update(vertices="AAAA"), "is truncated"),
        (lambda skin: skin.update(vertices="A" * (8 * MAX_VERTICES + 8)), "vertices"),
        (lambda skin: skin.update(vertices="é"), "vertices"),
        (lambda skin: skin.update(step=float("nan")), "step"),
        (lambda skin: skin["bones"][0].update(orientation=[0, 0, 0, 0]), "length 1"),
        (lambda skin: skin["bones"][0].update(number=500), "other bones"),
        (lambda skin: skin["parts"][0].update(name="a\n"), "name"),
        (lambda skin: skin["parts"][0].update(name=skin["parts"][1]["name"]), "two parts with the same name"),
        (lambda skin: skin.update(more=1), "more"),
    ],
)  # fmt: skip
def test_a_damaged_skin_is_refused(change: Callable[[dict[str, Any]], None], fault: str):
    described = skeleton().to_json()
    assert isinstance(described, dict)
    described = json.loads(json.dumps(described))
    change(described["skin"])
    with pytest.raises(ValueError, match=re.escape(fault)):
        Skeleton.from_json(described, human().nq)


TWO_SKINS = """<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="upper"><joint axis="0 1 0"/><geom size="0.1" group="3"/>
      <body name="lower" pos="0 0 -1"><joint axis="0 1 0"/><geom size="0.1" group="3"/></body>
    </body>
  </worldbody>
  <deformable>
    <skin name="one" vertex="0 0 0 1 0 0 0 1 0" face="0 1 2" rgba="1 0 0 1">
      <bone body="upper" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1 2" vertweight="1 1 1"/>
    </skin>
    <skin name="two" vertex="0 0 0 1 0 0 0 1 0 5 5 5" face="0 1 2" {two}>
      <bone body="upper" bindpos="{place} 0 0" bindquat="1 0 0 0" vertid="0 1 3" vertweight="1 3 1"/>
      <bone body="lower" bindpos="0 0 -1" bindquat="1 0 0 0" vertid="1 2" vertweight="1 1"/>
    </skin>
  </deformable>
</mujoco>"""


def test_skins_are_joined_as_far_as_they_are_drawn_and_bound_alike():
    def joined(two: str, place: float = 0) -> MeshSkin | None:
        text = TWO_SKINS.format(two=two, place=place)
        return skin_of(mujoco.MjModel.from_xml_string(text), 1)

    both = joined("")
    assert both is not None
    assert [part.name for part in both.parts] == ["one", "two"]
    assert len(both.arrays.vertices) == 6
    np.testing.assert_allclose(np.sort(both.arrays.weights[4])[-2:], [0.25, 0.75], atol=1 / 255)
    hidden = joined('group="3"')
    assert hidden is not None
    assert [part.name for part in hidden.parts] == ["one"]
    assert joined("", place=0.1) is None


def test_a_file_of_usd_has_the_joints_below_each_other_and_the_floor(tmp_path: Path):
    two = skeleton_of(mujoco.MjModel.from_xml_string(TWO_SKINS.format(two="", place=0)))
    write_usd(Clip("two", two, np.arange(2) / 30, np.zeros((2, 2))), tmp_path / "a.usda")
    text = (tmp_path / "a.usda").read_text()
    assert '"root", "root/world", "root/world/upper", "root/world/upper/lower"' in text
    assert re.findall('def GeomSubset "(.*)"', text) == ["one", "two"]
    assert text.count("def Mesh") == 2
