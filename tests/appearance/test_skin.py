"""A deformable body's bones go with its mass points, and its skin with the bones."""

from __future__ import annotations

import copy
import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import accessor, read_glb

from neuroanimator import Clip, NeuroAnimatorError, load_system, write_glb
from neuroanimator.appearance.loft import box_surface
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin import Box, Skin, Swimmer
from neuroanimator.appearance.skin_mesh import SkinMesh, colours_of, skin_mesh
from neuroanimator.errors import ArgumentError
from neuroanimator.film.camera import camera_path
from neuroanimator.film.graphics import graphics_backend
from neuroanimator.film.video import write_video
from neuroanimator.physics.deformable.bones import body_skeleton
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.state.rotation import rotate, rotate_back, rotation_matrices

ANIMALS = ("fish", "dolphin")
TURN = np.array([0.5, -0.5, 0.1, 0.7]) / np.linalg.norm([0.5, -0.5, 0.1, 0.7])


@functools.cache
def a_body(name: str) -> DeformableSystem:
    system = load_system(name)
    assert isinstance(system, DeformableSystem)
    return system


def a_box_skeleton() -> tuple[Skeleton, np.ndarray]:
    """Return eight corners under a box, and their state at rest."""
    cube = a_body("fish")
    corners = np.array([[x, y, z] for z in (0.1, 0.5) for x in (0.2, -0.2) for y in (0.3, -0.3)])
    body = copy.copy(cube.body)
    object.__setattr__(body, "positions", corners)
    object.__setattr__(body, "names", tuple(f"corner_{i}" for i in range(8)))
    return body_skeleton(body, Box(kind="box", face=(0.8, 0.2, 0.1), margin=0.01)), corners.ravel()


def skeletons() -> list[tuple[Skeleton, np.ndarray]]:
    animals = [a_body(name) for name in ANIMALS]
    return [*((animal.skeleton, animal.rest) for animal in animals), a_box_skeleton()]


def moved(points: np.ndarray) -> np.ndarray:
    """Return points (..., 3) turned and carried off."""
    return np.array([3.0, -2.0, 1.0]) + rotate(
        np.broadcast_to(TURN, (*points.shape[:-1], 4)), points
    )


def posed(skeleton: Skeleton, mesh: SkinMesh, states: np.ndarray) -> np.ndarray:
    """Return the points (T, V, 3) of the skin for states (T, S): every point carried by its bones."""
    positions, orientations = skeleton.world_poses(states)
    points = np.zeros((len(states), *mesh.points.shape))
    for i, bone in enumerate(skeleton.bones):
        at_rest = mesh.points - np.array(bone.offset)
        own = rotate_back(np.array(bone.orientation)[None], at_rest)
        carried = positions[:, i, None] + rotate(orientations[:, i, None], own[None])
        share = np.where(mesh.bones == i, mesh.weights, 0.0).sum(axis=1)
        points += share[:, None] * carried
    return points


def test_at_rest_the_skin_is_the_mesh_it_was_made_from_wherever_the_body_rests():
    for skeleton, rest in skeletons():
        mesh = skin_mesh(skeleton)
        offset = posed(skeleton, mesh, rest[None])[0] - mesh.points
        np.testing.assert_allclose(offset, np.broadcast_to(offset[0], offset.shape), atol=1e-12)
        assert np.abs(offset[0, :2]).max() < 1e-12


def test_moving_all_mass_points_rigidly_moves_the_skin_rigidly():
    rng = np.random.default_rng(0)
    for skeleton, rest in skeletons():
        mesh = skin_mesh(skeleton)
        count = 1 + max(bone.binding.last_entry for bone in skeleton.bones if bone.binding)
        bent = rest.copy()
        bent[:count] += rng.normal(size=count) * 0.01 * np.ptp(mesh.points)
        elsewhere = bent.copy()
        elsewhere[:count] = moved(bent[:count].reshape(-1, 3)).ravel()
        before, after = posed(skeleton, mesh, np.stack([bent, elsewhere]))
        np.testing.assert_allclose(after, moved(before), atol=1e-9)


def test_a_skin_is_smooth_closed_and_looks_outward():
    for skeleton, _ in skeletons():
        mesh = skin_mesh(skeleton)
        assert 200 < len(mesh.points) < 2000
        edges = np.concatenate(
            [mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]]
        )
        directed = {tuple(edge) for edge in edges.tolist()}
        assert len(directed) == len(edges)
        assert all((b, a) in directed for a, b in directed)
        corners = mesh.points[mesh.triangles]
        facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert ((facing * mesh.normals[mesh.triangles].mean(axis=1)).sum(axis=1) > 0).all()
        assert (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() > 0
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1)


def test_every_point_follows_at_most_four_bones_in_full():
    for skeleton, _ in skeletons():
        mesh = skin_mesh(skeleton)
        np.testing.assert_allclose(mesh.weights.sum(axis=1), 1)
        assert (mesh.weights >= 0).all()
        assert mesh.bones.shape == (len(mesh.points), 4)
        assert mesh.bones.max() < len(skeleton.bones)
        assert skeleton.skin is not None
        colours = colours_of(skeleton.skin, mesh.shades)
        assert ((colours >= 0) & (colours <= 1)).all()


def test_left_and_right_of_an_animal_look_the_same():
    for name in ANIMALS:
        points = skin_mesh(a_body(name).skeleton).points
        there = {tuple(row) for row in np.round(points, 6).tolist()}
        assert {(x, -y + 0.0, z) for x, y, z in there} == {(x, y + 0.0, z) for x, y, z in there}


def test_a_swimmers_bones_are_named_from_nose_to_tail():
    names = [bone.name for bone in a_body("fish").skeleton.bones]
    assert names == ["nose", "head", "chest", "waist", "loin", "stem", "tail"]


def test_a_box_has_the_volume_of_a_box_without_its_edges():
    surface, _ = box_surface(np.array([1.0, 1.0, 1.0]), 1e-6)
    corners = surface.points[surface.triangles]
    assert (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6 == pytest.approx(
        8, rel=1e-4
    )


def test_a_body_without_a_skin_shows_a_ball_at_every_mass_point():
    fish = a_body("fish")
    skeleton = body_skeleton(fish.body, None)
    positions, _ = skeleton.world_poses(fish.rest[None])
    np.testing.assert_array_equal(positions[0], fish.body.positions)
    assert all(bone.shapes[0].kind == "sphere" for bone in skeleton.bones)


def test_a_skeleton_survives_json():
    for skeleton, rest in skeletons():
        text = json.dumps(skeleton.to_json())
        assert Skeleton.from_json(json.loads(text), len(rest)) == skeleton
        assert hash(Skeleton.from_json(json.loads(text))) == hash(skeleton)
        assert len(text) < 10_000


def change(path: str, value: Any) -> Any:
    """Return a change of the JSON entry at `path`; None takes it away."""

    def apply(described: Any) -> None:
        *way, last = [int(step) if step.isdigit() else step for step in path.split(".")]
        for step in way:
            described = described[step]
        if value is None:
            del described[last]
        else:
            described[last] = value

    return apply


@pytest.mark.parametrize(
    "spoil",
    [
        change("bones.0.binding.position", []),
        change("bones.0.binding.position", [[0, 0.5]]),
        change("bones.0.binding.position", [[-1, 1.0]]),
        change("bones.0.binding.position", [[10**5, 1.0]]),
        change("bones.0.binding.position", [[0.5, 1.0]]),
        change("bones.0.binding.position", [[0, float("nan")]]),
        change("bones.0.binding.position", [[0, 1.0]] * 400),
        change("bones.0.binding.position", 7),
        change("bones.0.binding.up", []),
        change("bones.0.binding.up", [[0, 1.0]]),
        change("bones.0.binding.sideways", [[0, 1.0]]),
        change("bones.0.binding", [1]),
        change("bones.0.binding", None),
        change("bones.1.parent", 0),
        change("bones.0.offset", [0.0, 0.0]),
        change("bones.0.offset", [0.0, float("inf"), 0.0]),
        change("bones.0.offset", "abc"),
        change("bones.0.orientation", [1.0]),
        change("bones.0", "bone"),
        change("bones", []),
        change("bones", {"a": 1}),
        change("bones", None),
        change("skin.kind", "dragon"),
        change("skin.kind", "box"),
        change("skin.sections", [[0, 0, 0, 0]]),
        change("skin.sections", [[0, 0, 0, 0]] * 1000),
        change("skin.sections.0", [0, 0, 0, float("nan")]),
        change("skin.back", [2, 0, 0]),
        change("skin.fins.0.edge", [[0, 0, 0, -1]] * 3),
        change("skin.code", "import os"),
        change("skin", [1]),
    ],
)
def test_a_strangers_skeleton_is_refused(spoil: Any):
    described = json.loads(json.dumps(a_body("fish").skeleton.to_json()))
    spoil(described)
    with pytest.raises(ValueError):  # noqa: PT011 (whichever check finds it first)
        Skeleton.from_json(described, a_body("fish").state.size)


def test_a_skeleton_of_rigid_bodies_reads_as_before():
    system = load_system("truck")
    truck, size = system.skeleton, system.state.size
    rows = truck.to_json()
    assert isinstance(rows, list)
    assert "binding" not in rows[0]
    assert Skeleton.from_json(json.loads(json.dumps(rows)), size) == truck
    moving = next(row for row in rows if row["joints"])
    moving["joints"] = [joint | {"entry": 10**6} for joint in moving["joints"]]
    with pytest.raises(ValueError, match="state entries"):
        Skeleton.from_json(json.loads(json.dumps(rows)), size)


def test_a_skin_that_cannot_be_bound_is_refused_by_name():
    fish = a_body("fish")
    with pytest.raises(ArgumentError, match="eight mass points"):
        body_skeleton(fish.body, Box(kind="box", face=(1.0, 1.0, 1.0)))
    flat, stacked = copy.copy(fish.body), copy.copy(fish.body)
    object.__setattr__(flat, "positions", fish.body.positions * [1, 1, 0])
    object.__setattr__(stacked, "positions", fish.body.positions * [0, 1, 1])
    skin: Skin | None = fish.skeleton.skin
    assert isinstance(skin, Swimmer)
    with pytest.raises(ArgumentError, match="above each other"):
        body_skeleton(flat, skin)
    with pytest.raises(ArgumentError, match="along X"):
        body_skeleton(stacked, skin)


def swimming(name: str, frames: int = 12) -> Clip:
    """Return a made-up motion: a body that bends sideways and drifts."""
    system, times = a_body(name), np.arange(frames) / 30
    positions = np.repeat(system.body.positions[None], frames, axis=0)
    length = np.ptp(system.body.positions[:, 0])
    wave = (
        np.sin(9 * times[:, None] + 3 * positions[..., 0] / length)
        * (positions[..., 0] / length) ** 2
    )
    positions[..., 1] += 0.2 * length * wave
    positions[..., 0] += times[:, None] * length
    others = np.zeros((frames, system.state.size - positions[0].size))
    return Clip(
        name,
        system.skeleton,
        times,
        np.concatenate([positions.reshape(frames, -1), others], axis=1),
    )


@pytest.mark.parametrize("name", ANIMALS)
def test_a_viewer_of_the_glb_puts_the_skin_where_the_clip_has_it(name: str, tmp_path: Path):
    clip = swimming(name)
    write_glb(clip, tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    mesh: SkinMesh = skin_mesh(clip.skeleton)
    expected = posed(clip.skeleton, mesh, clip.states)[..., [0, 2, 1]] * [1, 1, -1]
    for frame in (0, len(clip.times) - 1):
        np.testing.assert_allclose(skinned(document, binary, frame), expected[frame], atol=1e-5)
    node = next(node for node in document["nodes"] if "skin" in node)
    assert document["nodes"].index(node) in document["scenes"][document["scene"]]["nodes"]


def skinned(document: dict, binary: bytes, frame: int) -> np.ndarray:
    """Return where the points of the skin are in the world, by the rules of glTF alone."""
    animation, nodes, skin = document["animations"][0], document["nodes"], document["skins"][0]
    matrices = []
    for joint in skin["joints"]:
        matrix = np.eye(4)
        for channel in (c for c in animation["channels"] if c["target"]["node"] == joint):
            output = accessor(
                document, binary, animation["samplers"][channel["sampler"]]["output"]
            )[frame]
            if channel["target"]["path"] == "translation":
                matrix[:3, 3] = output
            else:
                matrix[:3, :3] = rotation_matrices(output[[3, 0, 1, 2]].astype(float))
        matrices.append(matrix)
    scene = np.eye(4)
    scene[:3, :3] = rotation_matrices(np.array(nodes[0]["rotation"])[[3, 0, 1, 2]])
    bind = (
        accessor(document, binary, skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    )
    attributes = document["meshes"][0]["primitives"][0]["attributes"]

    def read(key):
        return accessor(document, binary, attributes[key])

    blended = np.einsum(
        "vk,vkij->vij", read("WEIGHTS_0"), (scene @ np.array(matrices) @ bind)[read("JOINTS_0")]
    )
    points = np.concatenate([read("POSITION"), np.ones((len(read("POSITION")), 1))], axis=1)
    return np.einsum("vij,vj->vi", blended, points)[:, :3]


def test_the_camera_goes_along_smoothly_and_loses_nobody():
    times = np.arange(150)[:, None] / 30
    steady = np.concatenate([times, 0.03 * np.sin(20 * times), 0 * times], axis=1)
    assert np.abs(camera_path(steady, 24, 0.3)[50:-50, 1]).max() < 0.003
    thrown = np.concatenate([0 * times, 0 * times, -9.81 / 2 * times**2], axis=1)
    assert np.linalg.norm(camera_path(thrown, 24, 0.05) - thrown, axis=1).max() <= 0.05
    np.testing.assert_array_equal(camera_path(thrown[:2], 24, 0.0)[0], thrown[0])


def test_an_animal_is_filmed_or_the_missing_library_named(tmp_path: Path):
    if graphics_backend() is None:
        with pytest.raises(NeuroAnimatorError, match="apt-get install libegl1 libosmesa6"):
            write_video(swimming("dolphin", 3), tmp_path / "a.mp4")
        return
    write_video(swimming("dolphin", 3), tmp_path / "a.mp4", size=(96, 64))
    assert (tmp_path / "a.mp4").read_bytes()[4:8] == b"ftyp"
