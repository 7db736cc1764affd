"""Paths of movers recorded elsewhere: what is read of tables and of characters, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from soft_bodies import soft_clip, wavy_shapes

import neuroanimator as na
from neuroanimator.animation.recorded_path import headings_of, paths_of_nodes, read_path
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.export.gltf.buffers import Buffer, as_float32, glb_bytes
from neuroanimator.files.glb import read_glb
from neuroanimator.state.layout import Layout, Slice

QUARTER = np.sqrt(0.5)


def character(
    path: Path,
    keys: np.ndarray,
    values: np.ndarray,
    interpolation: str = "LINEAR",
    target: str = "translation",
) -> dict:
    """Write a spine 1 m above hips that stand 2 m along glTF's z, half as large; what is animated are the hips."""
    buffer = Buffer()
    times = buffer.add(as_float32(keys), "SCALAR")
    output = buffer.add(as_float32(values), f"VEC{values.shape[1]}")
    sampler = {"input": times, "output": output, "interpolation": interpolation}
    document = {
        "asset": {"version": "2.0"},
        "nodes": [
            {"name": "hips", "translation": [0, 0, 2], "scale": [0.5] * 3, "children": [1]},
            {"name": "mixamorig:Spine", "translation": [0, 2, 0]},
        ],
        "animations": [
            {"channels": [{"sampler": 0, "target": {"node": 0, "path": target}}], "samplers": [sampler]}
        ],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }  # fmt: skip
    path.write_bytes(glb_bytes(document, bytes(buffer.content)))
    return document


def test_a_table_says_where_and_how_turned(tmp_path: Path):
    path = tmp_path / "walk.csv"
    path.write_text("time [s],x [m],y,z,heading\n1,0,0,1,3\n2,1,0,1,3.5\n3,2,-1,1,4\n")
    read = read_path(path)
    positions, orientations = read.at(np.array([1.0, 2.5]))
    np.testing.assert_allclose(positions, [[0, 0, 1], [1.5, -0.5, 1]])
    np.testing.assert_allclose(headings_of(orientations), [3, 3.75])


def test_a_path_in_other_notations_is_the_same_path(tmp_path: Path):
    times = np.arange(200) / 60
    headings = 2 * times
    plain = [f"{t:.6f},{1000 * t:.4f},0,1,{h:.9f}" for t, h in zip(times, headings, strict=True)]
    (tmp_path / "plain.csv").write_text("\n".join(["time,x,y,z,heading", *plain]))
    other = []
    for time, heading in zip(times, headings, strict=True):
        degrees = (np.rad2deg(heading) + 180) % 360 - 180
        millimetres = f"{1e6 * time:,.1f}".replace(",", " ").replace(".", ",")
        other.append(f"{1e3 * time:.0f};{millimetres};0;1000;{degrees:.7f}".replace(".", ","))
    header = "Time [ms];x (mm);y (mm);z (mm);heading [deg]"
    (tmp_path / "other.csv").write_text("\n".join([header, *other]))
    wanted = read_path(tmp_path / "plain.csv")
    found = read_path(tmp_path / "other.csv")
    assert wanted.orientations is not None
    np.testing.assert_allclose(found.times, wanted.times, atol=1e-3)
    np.testing.assert_allclose(np.diff(found.times), 1 / 60, rtol=1e-9)
    np.testing.assert_allclose(found.positions, wanted.positions, atol=1e-3)
    np.testing.assert_allclose(
        headings_of(found.orientations), headings_of(wanted.orientations), atol=1e-6
    )


def test_headings_of_quaternions_do_not_jump(tmp_path: Path):
    angles = np.linspace(0, 4 * np.pi, 60)
    rows = [
        f"{time},0,0,0,{np.cos(angle / 2)},0,0,{np.sin(angle / 2)}"
        for time, angle in enumerate(angles)
    ]
    path = tmp_path / "spin.csv"
    path.write_text("\n".join(["time,x,y,z,qw,qx,qy,qz", *rows]))
    np.testing.assert_allclose(headings_of(read_path(path).orientations), angles, atol=1e-9)


def test_what_animate_writes_of_a_body_drives_another(tmp_path: Path):
    clip = soft_clip(wavy_shapes(8))
    count = clip.states.shape[1] - 3
    layout = Layout((Slice("hand", 3, "m"), Slice("shapes", count, "m")))
    na.write_clip(clip, tmp_path / "flag.csv", layout)
    read = read_path(f"{tmp_path}/flag.csv:hand")
    np.testing.assert_allclose(read.positions, clip.states[:, :3], rtol=1e-6)


def test_a_node_goes_with_what_it_hangs_from_and_z_is_up(tmp_path: Path):
    keys = np.array([0.0, 1.0])
    character(tmp_path / "c.glb", keys, np.array([[0.0, 0, 2], [3, 0, 2]]))
    read = read_path(f"{tmp_path}/c.glb:mixamorig:Spine")
    positions, orientations = read.at(np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(positions, [[0, -2, 1], [1.5, -2, 1], [3, -2, 1]], atol=1e-6)
    np.testing.assert_allclose(headings_of(orientations), 0, atol=1e-6)


def test_a_character_that_turns_left_turns_by_a_heading(tmp_path: Path):
    turn = np.array([[0.0, 0, 0, 1], [0, QUARTER, 0, QUARTER]])
    character(tmp_path / "c.glb", np.array([0.0, 1.0]), turn, target="rotation")
    read = read_path(f"{tmp_path}/c.glb:mixamorig:Spine")
    _, orientations = read.at(np.array([0.0, 0.5, 1.0]))
    np.testing.assert_allclose(headings_of(orientations), [0, np.pi / 4, np.pi / 2], atol=1e-6)


def test_steps_stay_and_cubics_go_through_their_keys_at_their_slopes(tmp_path: Path):
    keys = np.array([0.0, 1.0, 2.0])
    places = np.array([[0.0, 0, 0], [1, 0, 0], [4, 0, 0]])
    character(tmp_path / "step.glb", keys, places, "STEP")
    stepped, _ = read_path(f"{tmp_path}/step.glb:hips").at(np.array([0.5, 1.5, 2.0]))
    np.testing.assert_allclose(stepped[:, 0], [0, 1, 4], atol=1e-6)
    slopes = 2 * keys[:, None] * [1.0, 0, 0]
    square = np.stack([slopes, places, slopes], axis=1).reshape(-1, 3)
    character(tmp_path / "cubic.glb", keys, square, "CUBICSPLINE")
    times = np.linspace(0, 2, 7)
    cubic, _ = read_path(f"{tmp_path}/cubic.glb:hips").at(times)
    np.testing.assert_allclose(cubic[:, 0], times**2, atol=1e-3)


def test_a_clip_written_is_the_path_that_is_read(tmp_path: Path):
    clip = soft_clip(wavy_shapes(8), frames=30)
    na.write_glb(clip, tmp_path / "flag.glb")
    read = read_path(f"{tmp_path}/flag.glb:hand")
    positions, _ = read.at(clip.times)
    np.testing.assert_allclose(positions, clip.states[:, :3], atol=1e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,x,y,z\n0,0,0,0\n", "at least two times, got 1"),
        ("time,x,y\n0,0,0\n1,0,0\n", "no column 'z'. .*Columns: 'time', 'x', 'y'"),
        ("time,x,y,z\n0,0,0,0\n1,nan,0,0\n", r"line 3, column 2 \(x\): wanted a finite number"),
        (
            "time,x,y,z\n0,0,0,0\n1,,0,0\n",
            r"line 3, column 2 \(x\): wanted a finite number, got ''",
        ),
        ("time,x,y,z\n0,0,0,0\n1,0,0\n", "line 3: 3 cells; wanted 4"),
        ("time,x,y,z\n0,0,0,0\n0,0,0,0\n", "rising times, got 0 s after 0 s"),
        ("time,x,y,z\n0,0,0,0\n1,0,0,0\n2,0,0,0\n90,0,0,0\n", "nothing between 2 s and 90 s"),
        ("time,x,y,z\n0,0,0,0\n1800,0,0,0\n3601,0,0,0\n", "wanted at most 3600"),
        ("time,x [s],y,z\n0,0,0,0\n1,0,0,0\n", "'x' is in 's'. Convert it to metres"),
        ("time [m],x,y,z\n0,0,0,0\n1,0,0,0\n", "'time' is in 'm'. Convert it to seconds"),
        ("time,x,x,y,z\n0,0,0,0,0\n1,0,0,0,0\n", "two columns are called 'x'"),
        ("time,x,y,z,qw,qx,qy,qz\n0,0,0,0,0,0,0,0\n1,0,0,0,1,0,0,0\n", "quaternion of zeros"),
        ("", "Columns: none"),
    ],
)
def test_a_table_that_is_no_path_is_refused(tmp_path: Path, text: str, message: str):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(BadFileError, match=message) as caught:
        read_path(tmp_path / "a.csv")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("source", ["walk.gltf:Spine", "walk", "walk.glb"])
def test_what_names_no_path_is_refused(source: str):
    with pytest.raises(ArgumentError, match="path: wanted"):
        read_path(source)


FORGED = {
    "no such node": (lambda document: document["nodes"][0].update(name="leg"), "no node called 'hips'"),
    "twins": (lambda document: document["nodes"][1].update(name="hips"), "2 nodes are called 'hips'"),
    "above itself": (lambda document: document["nodes"][1].update(children=[0]), "node above itself"),
    "two parents": (lambda document: document["nodes"][1].update(children=[1]), "two parents"),
    "no child": (lambda document: document["nodes"][0].update(children=[7]), "wanted a whole number from 0 to 1"),
    "no animation": (lambda document: document.pop("animations"), "no animation"),
    "no nodes": (lambda document: document.update(nodes={}), "nodes: wanted a list"),
    "a long array": (lambda document: document["accessors"][0].update(count=10**9), "wanted a whole number"),
    "beyond the view": (lambda document: document["accessors"][1].update(count=3), "beyond its bufferView"),
    "beyond the file": (lambda document: document["bufferViews"][0].update(byteLength=10**6), "byteLength: wanted"),
    "an offset below": (lambda document: document["accessors"][0].update(byteOffset=-4), "byteOffset: wanted"),
    "numbers elsewhere": (lambda document: document["buffers"][0].update(uri="a.bin"), "another file"),
    "compressed": (lambda document: document["bufferViews"][0].update(extensions={"a": {}}), "compressed"),
    "few values": (lambda document: document["accessors"][1].update(count=1), "1 values at 2 keyframes"),
    "huge": (lambda document: document["nodes"][0].update(scale=[1e9, 1, 1]), "scale: wanted a number"),
    "flat": (lambda document: document["nodes"][1].update(matrix=[0] * 16), "not a rotation and a scale"),
}  # fmt: skip
"""By name, a change of a character's document, and what is said of it."""


@pytest.mark.attack
@pytest.mark.parametrize("name", FORGED)
def test_a_forged_character_is_refused(tmp_path: Path, name: str):
    forge, message = FORGED[name]
    path = tmp_path / "c.glb"
    keys = np.array([0.0, 1.0])
    document = character(path, keys, np.array([[0.0, 0, 2], [3, 0, 2]]))
    content = path.read_bytes()
    length = int.from_bytes(content[12:16], "little")
    forge(document)
    path.write_bytes(glb_bytes(document, content[28 + length :]))
    node = "mixamorig:Spine" if name == "flat" else "hips"
    with pytest.raises(BadFileError, match=message) as caught:
        read_path(f"{path}:{node}")
    assert "\n" not in str(caught.value)


@pytest.mark.attack
def test_a_container_cut_off_anywhere_is_refused(tmp_path: Path):
    path = tmp_path / "c.glb"
    character(path, np.array([0.0, 1.0]), np.array([[0.0, 0, 2], [3, 0, 2]]))
    content = path.read_bytes()
    for end in range(0, len(content), 7):
        path.write_bytes(content[:end])
        with pytest.raises(BadFileError):
            read_path(f"{path}:hips")
    deep = json.loads("[" * 50 + "]" * 50)
    path.write_bytes(glb_bytes({"nodes": deep}, b""))
    with pytest.raises(BadFileError, match="wanted JSON objects"):
        read_path(f"{path}:hips")
    with pytest.raises(BadFileError, match="wanted JSON objects"):
        paths_of_nodes(read_glb(path), path, ["hips"])
