"""Exported files hold the poses they were given."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from neuroanimator import Clip, Emulator, NeuroAnimatorError, make_clip, read_clip, write_clip, write_glb, write_video
from neuroanimator.animation.motion import random_motion
from neuroanimator.export.capsule import capsule_mesh
from neuroanimator.export.gltf import continuous
from neuroanimator.export.video import graphics_backend
from neuroanimator.systems.skeleton import rotation_matrices


@pytest.fixture(scope="module")
def clip(shipped: Emulator) -> Clip:
    return make_clip(shipped, random_motion(shipped, 1.0, seed=3))


def read_glb(path: Path) -> tuple[dict, bytes]:
    raw = path.read_bytes()
    magic, version, total, length = np.frombuffer(raw[:16], "<u4")
    assert (magic, version, total) == (0x46546C67, 2, len(raw))
    return json.loads(raw[20 : 20 + length]), raw[20 + length + 8 :]


def accessor(document: dict, binary: bytes, index: int) -> np.ndarray:
    entry = document["accessors"][index]
    view = document["bufferViews"][entry["bufferView"]]
    kind = {5126: "<f4", 5123: "<u2"}[entry["componentType"]]
    data = np.frombuffer(binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]], kind)
    return data.reshape(entry["count"], -1)


def test_f21_the_glb_poses_are_the_clips_poses_with_y_up(clip: Clip, tmp_path: Path):
    write_glb(clip, tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    expected = clip.skeleton.world_points(clip.states)[:, -1, 1]
    samplers = document["animations"][0]["samplers"]
    turns = [
        rotation_matrices(accessor(document, binary, s["output"])[:, [3, 0, 1, 2]].astype(float)) for s in samplers
    ]
    root = rotation_matrices(np.array(document["nodes"][0]["rotation"])[[3, 0, 1, 2]])
    for frame in (0, len(clip.times) // 2, len(clip.times) - 1):
        position, turn = np.zeros(3), root
        for node, track in zip(document["nodes"][1:], turns, strict=True):
            position = position + turn @ np.array(node["translation"])
            turn = turn @ track[frame]
        tip = position + turn @ np.array(clip.skeleton.bones[-1].end)
        x, y, z = expected[frame]
        np.testing.assert_allclose(tip, [x, z, -y], atol=1e-5)
    np.testing.assert_allclose(accessor(document, binary, samplers[0]["input"])[:, 0], clip.times, atol=1e-6)


def test_quaternions_never_jump_to_the_other_sign(clip: Clip):
    spinning = np.repeat(np.linspace(0, 20, 200)[:, None], 6, axis=1)
    turns = continuous(clip.skeleton.local_rotations(spinning))
    assert ((turns[1:] * turns[:-1]).sum(axis=-1) > 0).all()


def test_a_capsule_is_closed_and_faces_outward():
    points, normals, triangles = capsule_mesh(np.array([0, 0, 0.0]), np.array([0, 0, -0.5]), 0.03)
    assert points.min() == pytest.approx(-0.53, abs=1e-6)
    corners = points[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(facing, axis=1)
    outward = (facing * normals[triangles].mean(axis=1)).sum(axis=1)
    assert (outward[area > 1e-9] > 0).all()


def test_a_table_round_trip_keeps_the_clip(clip: Clip, shipped: Emulator, tmp_path: Path):
    write_clip(clip, tmp_path / "a.csv", shipped.identity.state)
    again = read_clip(tmp_path / "a.csv", shipped)
    np.testing.assert_allclose(again.states, clip.states, rtol=1e-7, atol=1e-8)
    assert again.rate == pytest.approx(30)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("angle[0] rad", "angle"), "wanted the header"),
        (lambda text: text.splitlines()[0] + "\n", "no rows"),
        (lambda text: text + "1,2,3\n", "line 33: wanted 7 finite numbers"),
        (lambda text: text + "nan,0,0,0,0,0,0\n", "line 33"),
        (lambda text: text + "x,0,0,0,0,0,0\n", "line 33"),
        (lambda text: text + "9,0,0,0,0,0,0\n", "evenly spaced"),
    ],
)
def test_a_bad_table_is_refused_by_line(change, message, clip: Clip, shipped: Emulator, tmp_path: Path):
    path = tmp_path / "a.csv"
    write_clip(clip, path, shipped.identity.state)
    path.write_text(change(path.read_text()))
    with pytest.raises(NeuroAnimatorError, match=message):
        read_clip(path, shipped)


def test_a_video_is_drawn_or_the_missing_library_named(clip: Clip, tmp_path: Path):
    path = tmp_path / "a.mp4"
    if graphics_backend() is None:
        with pytest.raises(NeuroAnimatorError, match="apt-get install libegl1 libosmesa6"):
            write_video(clip, path)
        return
    write_video(clip, path, width=128, height=128)
    assert path.read_bytes()[4:8] == b"ftyp"
    assert path.stat().st_size > 2000


def test_f16_without_graphics_one_line_says_what_to_install(clip: Clip, tmp_path: Path, monkeypatch):
    monkeypatch.setitem(os.environ, "MUJOCO_GL", "disabled")
    with pytest.raises(NeuroAnimatorError, match="apt-get install libegl1 libosmesa6"):
        write_video(clip, tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())
