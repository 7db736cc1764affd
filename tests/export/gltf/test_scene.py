"""Exported files hold the poses they were given."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Cli, accessor, read_glb

from neuroanimator import (
    Clip,
    Emulator,
    NeuroAnimatorError,
    load_system,
    make_clip,
    read_clip,
    write_clip,
    write_glb,
    write_video,
)
from neuroanimator.animation.motion import random_drive
from neuroanimator.appearance.shape_mesh import shape_mesh
from neuroanimator.appearance.skeleton import SHAPE_KINDS, Shape
from neuroanimator.export.csv_file import read_controls, write_table
from neuroanimator.film import graphics
from neuroanimator.film.graphics import graphics_backend
from neuroanimator.state.rotation import continuous, rotation_matrices


@pytest.fixture(scope="module")
def clip(shipped: Emulator) -> Clip:
    return make_clip(shipped, random_drive(shipped, 1.0, seed=3).motion(shipped))


@pytest.mark.parametrize("name", ["pendulum", "truck", "lander"])
def test_f21_the_glb_poses_are_the_clips_poses_with_y_up(name: str, tmp_path: Path):
    clip = a_clip(name)
    write_glb(clip, tmp_path / "a.glb")
    document, binary = read_glb(tmp_path / "a.glb")
    positions, _ = clip.skeleton.world_poses(clip.states)
    tracks: dict[tuple[int, str], np.ndarray] = {}
    animation = document["animations"][0]
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        target = channel["target"]
        tracks[target["node"], target["path"]] = accessor(
            document, binary, sampler["output"]
        ).astype(float)
        np.testing.assert_allclose(
            accessor(document, binary, sampler["input"])[:, 0], clip.times, atol=1e-6
        )
    for frame in (0, len(clip.times) // 2, len(clip.times) - 1):
        found = glb_places(document, tracks, frame)
        expected = positions[frame][:, [0, 2, 1]] * [1, 1, -1]
        np.testing.assert_allclose(found[1:], expected, atol=1e-5)


def a_clip(name: str) -> Clip:
    system, rng = load_system(name), np.random.default_rng(0)
    states = np.repeat(system.sample_starts(rng, 1), 31, axis=0)
    for view in range(system.state.size):  # every entry moves, so that every joint is tried
        states[:, view] += np.linspace(0, 0.3, 31) * np.sin(view + 1)
    return Clip(name, system.skeleton, np.arange(31) / 30, states)


def glb_places(document: dict, tracks: dict[tuple[int, str], np.ndarray], frame: int) -> np.ndarray:
    """Return where each node is, by the rules of glTF alone."""
    nodes = document["nodes"]
    found = np.zeros((len(nodes), 3))

    def visit(index: int, position: np.ndarray, orientation: np.ndarray) -> None:
        node = nodes[index]
        own = tracks.get((index, "rotation"))
        rotation = np.array(node.get("rotation", [0, 0, 0, 1])) if own is None else own[frame]
        way = tracks.get((index, "translation"))
        translation = np.array(node.get("translation", [0, 0, 0])) if way is None else way[frame]
        found[index] = position + orientation @ translation
        for child in node.get("children", []):
            visit(child, found[index], orientation @ rotation_matrices(rotation[[3, 0, 1, 2]]))

    visit(0, np.zeros(3), np.eye(3))
    return found


def test_quaternions_never_jump_to_the_other_sign(clip: Clip):
    spinning = np.repeat(np.linspace(0, 20, 200)[:, None], 6, axis=1)
    orientations = continuous(clip.skeleton.local_poses(spinning)[1])
    assert ((orientations[1:] * orientations[:-1]).sum(axis=-1) > 0).all()


@pytest.mark.parametrize("kind", SHAPE_KINDS)
def test_a_shape_is_closed_faces_outward_and_has_its_size(kind: str):
    size = {"capsule": (0.1, 0.4), "cylinder": (0.1, 0.4), "sphere": (0.3,)}.get(
        kind, (0.1, 0.2, 0.3)
    )
    mesh = shape_mesh(
        Shape(
            kind,
            size,
            (1.0, 0.0, 0.0),
            (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0),
            (1.0, 1.0, 1.0, 1.0),
        )
    )
    corners = mesh.points[mesh.triangles].astype(float)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = (facing * mesh.normals[mesh.triangles].mean(axis=1)).sum(axis=1)
    assert (outward[np.linalg.norm(facing, axis=1) > 1e-9] > 0).all()
    volume = (
        corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])
    ).sum() / 6  # divergence theorem: only if closed
    exact = {
        "capsule": np.pi * 0.01 * (0.8 + 4 / 3 * 0.1), "cylinder": np.pi * 0.01 * 0.8, "sphere": 4 / 3 * np.pi * 0.027,
        "ellipsoid": 4 / 3 * np.pi * 0.006, "box": 8 * 0.006,
    }[kind]  # fmt: skip
    assert volume == pytest.approx(exact, rel=0.06)


def test_a_table_round_trip_keeps_the_clip(clip: Clip, shipped: Emulator, tmp_path: Path):
    write_clip(clip, tmp_path / "a.csv", shipped.state)
    again = read_clip(tmp_path / "a.csv", shipped)
    np.testing.assert_allclose(again.states, clip.states, rtol=1e-7, atol=1e-8)
    assert again.rate == pytest.approx(30)


def test_controls_at_another_rate_are_refused_by_row(shipped: Emulator, tmp_path: Path):
    path = tmp_path / "c.csv"
    controls = np.ones((9, shipped.control.size))
    times = shipped.dt * np.arange(9)
    write_table(path, times, controls, shipped.control)
    np.testing.assert_array_equal(read_controls(path, shipped), controls)
    for wrong in (2 * times, 1e3 * times, np.delete(np.append(times, 9 * shipped.dt), 4)):
        write_table(path, wrong, controls, shipped.control)
        with pytest.raises(NeuroAnimatorError, match=r"c.csv, row \d: .* wanted 0.05 s"):
            read_controls(path, shipped)


def test_a_table_with_times_in_milliseconds_is_read_at_its_rate(
    clip: Clip, shipped: Emulator, tmp_path: Path
):
    write_clip(clip, tmp_path / "a.csv", shipped.state)
    header, *rows = (tmp_path / "a.csv").read_text().splitlines()
    cells = [row.split(",", 1) for row in rows]
    rounded = [f"{float(time):.3f},{rest}" for time, rest in cells]
    (tmp_path / "a.csv").write_text("\n".join([header, *rounded]))
    assert read_clip(tmp_path / "a.csv", shipped).rate == pytest.approx(clip.rate, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("angle[0] rad", "angle"), "wanted the header"),
        (lambda text: text.splitlines()[0] + "\n", "no rows"),
        (lambda text: text + "1,2,3\n", "line 33: 3 cells; wanted 7"),
        (lambda text: text + "nan,0,0,0,0,0,0\n", "line 33"),
        (lambda text: text + "x,0,0,0,0,0,0\n", "line 33"),
        (lambda text: text + "9,0,0,0,0,0,0\n", "evenly spaced"),
    ],
)
def test_a_bad_table_is_refused_by_line(
    change, message, clip: Clip, shipped: Emulator, tmp_path: Path
):
    path = tmp_path / "a.csv"
    write_clip(clip, path, shipped.state)
    path.write_text(change(path.read_text()))
    with pytest.raises(NeuroAnimatorError, match=message):
        read_clip(path, shipped)


def test_a_video_is_drawn_or_the_missing_library_named(clip: Clip, tmp_path: Path):
    path = tmp_path / "a.mp4"
    if graphics_backend() is None:
        with pytest.raises(NeuroAnimatorError, match="apt-get install libegl1 libosmesa6"):
            write_video(clip, path)
        return
    write_video([clip, clip], path, size=(128, 128), camera="still")
    assert path.read_bytes()[4:8] == b"ftyp"
    assert path.stat().st_size > 2000


def test_f16_without_graphics_one_line_says_what_to_install(
    clip: Clip, tmp_path: Path, monkeypatch
):
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    with pytest.raises(NeuroAnimatorError, match="MUJOCO_GL=disabled asks to draw with disabled"):
        write_video(clip, tmp_path / "a.mp4")
    monkeypatch.delenv("MUJOCO_GL")
    monkeypatch.setattr(graphics, "BACKENDS", ("disabled",))
    with pytest.raises(NeuroAnimatorError, match="apt-get install libegl1 libosmesa6"):
        write_video(clip, tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


def test_a_graphics_library_that_is_missing_is_named_before_mujoco_is_imported(
    cli_process: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("MUJOCO_GL", "nothing")
    done = cli_process("animate", "pendulum", "--out", tmp_path / "a.mp4")
    assert done.returncode == 4
    assert "MUJOCO_GL=nothing asks to draw with nothing" in done.stderr
    assert "Unexpected" not in done.stderr
    assert not list(tmp_path.iterdir())
