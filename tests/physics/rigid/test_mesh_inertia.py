"""Where MuJoCo's default inertia of a mesh is not that of its shape, `new` says so, and the remedy ends it."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator.physics.rigid.compiled_model import ModelRequest
from neuroanimator.physics.rigid.mesh_inertia import TOLERANCE, warnings_here
from neuroanimator.scaffold.model import propose
from neuroanimator.systems.model_files import read_model_files

TRIANGLES = ((0, 1, 5), (1, 4, 5), (1, 2, 3), (1, 3, 4), (0, 5, 6), (0, 6, 7))
"""Triangles of the front of a U with eight corners."""


def channel(depth: float, walls: float, is_inside_out: bool = False) -> str:
    """Return a closed mesh: a square bar with a channel `depth` deep between `walls` so thick, as shares of its width."""
    wall = walls / 2
    floor = 1 - depth
    u = [(0, 0), (1, 0), (1, 1), (1 - wall, 1), (1 - wall, floor), (wall, floor), (wall, 1), (0, 1)]
    corners = [(x, y, z) for y in (0, 1) for x, z in u]
    faces = [triangle for a, b, c in TRIANGLES for triangle in ((a, b, c), (a + 8, c + 8, b + 8))]
    for corner in range(8):
        following = (corner + 1) % 8
        faces += [(corner, following + 8, following), (corner, corner + 8, following + 8)]
    turned = np.array(faces)[:, ::-1] if is_inside_out else np.array(faces)
    vertices = " ".join(f"{x:g}" for x in np.ravel(corners))
    return f'vertex="{vertices}" face="{" ".join(map(str, turned.ravel()))}"'


def model_with(mesh: str, geom: str = "", body: str = "") -> str:
    return f"""<mujoco><asset><mesh name="u" {mesh}/></asset><worldbody><body name="b">{body}
      <joint name="j" axis="0 1 0" damping="0.1"/><geom type="mesh" mesh="u" density="1" contype="0" conaffinity="0" {geom}/>
      </body></worldbody><actuator><motor name="m" joint="j" ctrlrange="-1 1"/></actuator></mujoco>"""


def warnings_on(folder: Path, text: str) -> list[str]:
    path = folder / "model.xml"
    path.write_text(text)
    files = read_model_files(path)
    return warnings_here(ModelRequest(files.main, files.documents()))


def largest_difference(own: str, other: str) -> float:
    models = [mujoco.MjModel.from_xml_string(text) for text in (own, other)]
    mine, its = (np.append(np.sort(model.body_inertia[1]), model.body_mass[1]) for model in models)
    return float(np.max(np.abs(mine - its) / its))


def test_a_mesh_is_named_where_its_inertia_is_not_that_of_its_shape(tmp_path: Path):
    rng = np.random.default_rng(0)
    named = 0
    for _ in range(40):
        mesh = channel(*rng.uniform(0.02, 0.9, 2), is_inside_out=bool(rng.random() < 0.3))
        text = model_with(mesh, geom=str(rng.choice(["", 'mass="2"'])))
        mode = "exact"
        try:
            difference = largest_difference(text, text.replace("<mesh", '<mesh inertia="exact"'))
        except ValueError:  # MuJoCo has no exact inertia for what is inside out
            mode = "convex"
            difference = largest_difference(text, text.replace("<mesh", '<mesh inertia="convex"'))
        if abs(difference - TOLERANCE) < 1e-3:
            continue
        said = warnings_on(tmp_path, text)
        assert len(said) == (difference > TOLERANCE)
        for warning in said:
            named += 1
            assert warning.startswith("mesh 'u': ")
            told = re.search(r'Write (inertia="\w+") into that <mesh>', warning)
            assert told is not None
            assert mode in told[1]
            assert not warnings_on(tmp_path, text.replace("<mesh", f"<mesh {told[1]}"))
    assert 5 < named < 35


@pytest.mark.parametrize("inertial", ["", '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'])
def test_what_says_its_own_inertia_is_not_doubted(tmp_path: Path, inertial: str):
    said = warnings_on(tmp_path, model_with(channel(0.8, 0.3), body=inertial))
    assert bool(said) == (not inertial)


def test_the_inertia_of_a_link_belongs_into_the_link(tmp_path: Path):
    (tmp_path / "u.obj").write_text(wavefront(channel(0.8, 0.3)))
    mesh = '<collision><geometry><mesh filename="u.obj"/></geometry></collision>'
    (tmp_path / "r.urdf").write_text(
        f'<robot name="r"><link name="a"/><link name="b">{mesh}</link><joint name="j" type="continuous"><parent link="a"/>'
        '<child link="b"/><axis xyz="0 1 0"/><limit effort="1" velocity="1"/></joint></robot>'
    )
    files = read_model_files(tmp_path / "r.urdf")
    [said] = warnings_here(ModelRequest(files.main, files.documents()))
    assert said.endswith("Give its link an <inertial>.")


def wavefront(mesh: str) -> str:
    """Return the text of an OBJ file of such a mesh."""
    vertices, faces = (part.split() for part in re.findall(r'"([^"]*)"', mesh))
    lines = [f"v {' '.join(vertices[i : i + 3])}" for i in range(0, len(vertices), 3)]
    corners = [str(int(corner) + 1) for corner in faces]
    lines += [f"f {' '.join(corners[i : i + 3])}" for i in range(0, len(corners), 3)]
    return "\n".join(lines) + "\n"


def test_new_warns_of_a_mesh(tmp_path: Path):
    (tmp_path / "u.xml").write_text(model_with(channel(0.8, 0.3)))
    assert any(
        warning.startswith("mesh 'u': the mass") for warning in propose(tmp_path / "u.xml").warnings
    )
