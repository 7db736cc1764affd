"""Laws of meshes that `new` is given: any is proposed and simulates, or is refused in one line with the file's numbers."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from jelly_mesh import cube, msh_2, msh_4

from neuroanimator.cli import new
from neuroanimator.definitions.soft import SoftDefinition
from neuroanimator.errors import ArgumentError, BadFileError, NeuroAnimatorError
from neuroanimator.files.tables import check_table, read_toml
from neuroanimator.physics.soft.mesh_file import read_mesh
from neuroanimator.physics.soft.polygons import triangulated
from neuroanimator.physics.soft.scene import Scene
from neuroanimator.physics.soft.soft_scene import Motion
from neuroanimator.scaffold import soft
from neuroanimator.scaffold.teacher import affordable_count
from neuroanimator.scaffold.write_toml import write_definition

FRAME = 1 / 30

Surface = tuple[np.ndarray, list[list[int]]]
"""Vertices, and the corners of faces."""


def rolled(rows: int, columns: int, place, *, closed: bool = False) -> Surface:
    """Return quads over a grid of parameters from 0 to 1, which `place` puts into space; closed ones join the last column."""
    u, v = np.meshgrid(
        np.linspace(0, 1, columns, endpoint=not closed), np.linspace(0, 1, rows), indexing="xy"
    )
    vertices = np.stack(place(u.ravel(), v.ravel()), axis=1)
    faces = []
    for row in range(rows - 1):
        for column in range(columns if closed else columns - 1):
            after = (column + 1) % columns
            low, high = row * columns, (row + 1) * columns
            faces.append([low + column, high + column, high + after, low + after])
    return vertices, faces


def sheet(side: int = 5) -> Surface:
    return rolled(side, side, lambda u, v: (u - 0.5, 0 * u, 1.5 - v))


def cape() -> Surface:
    return rolled(
        6, 5, lambda u, v: (np.sin(2 * (u - 0.5)) / 2, 0.3 * np.cos(2 * (u - 0.5)), 1.5 - v)
    )


def tube() -> Surface:
    around = 2 * np.pi
    return rolled(
        6, 8, lambda u, v: (0.3 * np.cos(around * u), 0.3 * np.sin(around * u), 1 - v), closed=True
    )


def ball(from_latitude: float = 0.0) -> Surface:
    """Return a sphere; with quads without a side at its poles, as several exporters write them."""
    around = 2 * np.pi

    def place(u, v):
        latitude = np.pi * (from_latitude + (1 - from_latitude) * v)
        ring = 0.4 * np.sin(latitude)
        return ring * np.cos(around * u), ring * np.sin(around * u), 0.4 * np.cos(latitude)

    return rolled(7, 9, place, closed=True)


SURFACES = {"sheet": sheet, "cape": cape, "tube": tube, "ball": ball, "bowl": lambda: ball(0.5)}


def obj(vertices: np.ndarray, faces: list[list[int]]) -> str:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices.tolist()]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    return "\n".join([*lines, ""])


def torn(vertices: np.ndarray, faces: list[list[int]]) -> Surface:
    """Return the surface with a vertex of its own for each corner of each face."""
    corners = [corner for face in faces for corner in face]
    ends = np.cumsum([len(face) for face in faces])
    own = [list(range(end - len(face), end)) for face, end in zip(faces, ends, strict=True)]
    return vertices[corners], own


def in_triangles(vertices: np.ndarray, faces: list[list[int]]) -> Surface:
    return vertices, [[face[0], *pair] for face in faces for pair in pairwise(face[1:])]


def with_middles(vertices: np.ndarray, faces: list[list[int]]) -> Surface:
    """Return the surface with every other face cut into four: the faces beside it have vertices in their edges."""
    points = vertices.tolist()
    cut = []
    for number, face in enumerate(faces):
        if number % 2:
            cut.append(face)
            continue
        first = len(points)
        middles = [
            (vertices[a] + vertices[b]) / 2 for a, b in zip(face, np.roll(face, -1), strict=True)
        ]
        points += [*middles, vertices[face].mean(axis=0)]
        for place, corner in enumerate(face):
            cut.append([corner, first + place, first + len(face), first + (place - 1) % len(face)])
    return np.array(points), cut


CHANGES = {
    "quads": lambda vertices, faces: (vertices, faces),
    "triangles": in_triangles,
    "torn": torn,
    "turned round": lambda vertices, faces: (vertices, [face[::-1] for face in faces]),
    "with T": with_middles,
}


def simulated(toml: Path) -> Scene:
    """Return the scene of a TOML file after checking that its springs hold for a moment."""
    definition = check_table(read_toml(toml), toml.name, SoftDefinition)
    content = (toml.parent / definition.mesh).read_bytes()
    scene = Scene(definition, read_mesh(definition.mesh, content, definition))
    rest = np.repeat(scene.movers.rest[None], 9, axis=0)
    still = np.zeros_like(scene.positions)
    played, _ = scene.play(Motion(scene.positions, still), rest, FRAME, 40)
    assert np.isfinite(played).all()
    first, second = scene.body.pairs.T
    lengths = np.linalg.norm(played[-1][second] - played[-1][first], axis=1)
    assert (lengths < 3 * scene.body.lengths + 0.02 * scene.size).all()
    return scene


def ends_of(faces: list[list[int]]) -> list[tuple[int, int]]:
    return [ends for face in faces for ends in pairwise([*face, face[0]])]


def area_of(vertices: np.ndarray, faces: list[list[int]]) -> float:
    total = 0.0
    for a, b, c in in_triangles(vertices, faces)[1]:
        edges = vertices[[b, c]] - vertices[a]
        total += float(np.linalg.norm(np.cross(*edges))) / 2
    return total


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("shape", SURFACES)
def test_any_sound_surface_is_proposed_and_simulates(shape: str, change: str, tmp_path: Path):
    vertices, faces = SURFACES[shape]()
    (tmp_path / "my.obj").write_text(obj(*CHANGES[change](vertices, faces)))
    toml, proposal = write_definition(str(tmp_path / "my.obj"))
    scene = simulated(toml)
    assert scene.mesh.pieces().max() == 0
    if change != "with T":  # the middle of a round edge is off it
        whole = area_of(vertices, faces)
        np.testing.assert_allclose(scene.mesh.sizes().sum(), whole, rtol=2e-2)
    assert proposal.data_seconds > 0


@pytest.mark.parametrize("seed", range(12))
def test_a_face_of_any_outline_becomes_triangles_that_fill_it(seed: int):
    """Star-shaped outlines with deep notches and corners on straight edges, anywhere in space, to six digits."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 40))
    angles = np.sort(rng.uniform(0, 2 * np.pi / count, count) * 0.8) + 2 * np.pi * np.arange(
        count
    ) / (count)
    radii = rng.uniform(0.2, 1, count)
    outline = np.stack([radii * np.cos(angles), radii * np.sin(angles), 0 * radii], axis=1)
    more = []
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        shares = np.sort(rng.uniform(0.1, 0.9, rng.integers(0, 3)))
        more += [start, *(start + share * (end - start) for share in shares)]
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    vertices = np.round(np.array(more) @ turned.T + rng.normal(size=3), 6)
    face = np.roll(np.arange(len(vertices)), rng.integers(len(vertices))).tolist()
    mesh = triangulated("my.obj", vertices, [face], [7])
    np.testing.assert_array_equal(mesh.positions, vertices)
    assert len(mesh.elements) == len(face) - 2
    after = np.roll(vertices, -1, axis=0)
    whole = np.linalg.norm(np.cross(vertices, after).sum(axis=0)) / 2
    np.testing.assert_allclose(mesh.sizes().sum(), whole, rtol=1e-4)
    sides = set(ends_of(mesh.elements.tolist()))
    assert set(ends_of([face])) <= sides
    assert (mesh.lines == 7).all()


@pytest.mark.parametrize("seed", range(6))
def test_faces_of_different_sizes_meet_corner_to_corner(seed: int):
    """Rows of a sheet, each cut into as many faces as chance will have: vertices lie in the edges of the rows beside."""
    rng = np.random.default_rng(seed)
    vertices, faces = [], []
    for row in range(4):
        cuts = np.linspace(0, 1, int(rng.integers(2, 9)))
        first = len(vertices)
        vertices += [(x, 0.0, z) for z in (1 - row / 4, 1 - (row + 1) / 4) for x in cuts]
        for cell in range(len(cuts) - 1):
            high, low = first + cell, first + len(cuts) + cell
            faces.append([high, low, low + 1, high + 1])
    mesh = triangulated("my.obj", np.array(vertices), faces, list(range(len(faces))))
    assert mesh.pieces().max() == 0
    np.testing.assert_allclose(mesh.sizes().sum(), 1.0)
    sides = np.stack([mesh.elements, np.roll(mesh.elements, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, counts = np.unique(np.sort(sides, axis=1), axis=0, return_counts=True)
    at_the_rim = edges[counts == 1]
    x, _, z = mesh.positions[at_the_rim].mean(axis=1).T
    assert (np.isin(x, (0, 1)) | np.isin(z, (0, 1))).all()


def test_an_l_shaped_face_with_corners_on_its_sides_is_no_fault(tmp_path: Path):
    line = np.linspace(0, 1, 4)
    vertices = np.array([(x - 0.5, 0, 1.5 - z) for z in line for x in line])
    numbers = ("1 5 9 10 6 7 3 2", "3 7 8 4", "6 10 11 7", "7 11 12 8", "9 13 14 10")
    numbers = (*numbers, "10 14 15 11", "11 15 16 12")
    faces = [[int(number) - 1 for number in row.split()] for row in numbers]
    (tmp_path / "l.obj").write_text(obj(vertices, faces))
    toml, _ = write_definition(str(tmp_path / "l.obj"))
    np.testing.assert_allclose(simulated(toml).mesh.sizes().sum(), 1.0)


def test_faces_without_area_are_left_out_and_said(tmp_path: Path):
    vertices, faces = sheet()
    text = obj(vertices, [*faces, [0, 1, 1], [0, 1, 2], [3, 4, 3]])
    (tmp_path / "my.obj").write_text(text)
    toml, proposal = write_definition(str(tmp_path / "my.obj"))
    lines = text.splitlines()
    first = lines.index("f 1 2 2") + 1
    assert f"lines {first}, {first + 1}, {first + 2}" in dict(proposal.told)["mended"]
    assert len(simulated(toml).mesh.elements) == 2 * len(faces)


@pytest.mark.parametrize(
    ("faces", "words"),
    [
        ([[0, 1, 2, 3], [4, 6, 5, 7]], "line 10: the edges of a face cross"),
        ([[0, 1, 2, 3], [3, 2, 0]], "opposite ways|share the edge"),
        (
            [[0, 1, 2, 3], [0, 1, 5, 4]],
            "facing opposite ways: neighbouring triangles of lines 9, 10",
        ),
        ([[0, 1, 0], [1, 2, 1]], "no face has an area"),
    ],
)
def test_what_is_no_surface_is_refused_by_its_line(faces, words: str, tmp_path: Path):
    square = np.array([(0, 0, 1), (0, 0, 0), (1, 0, 0), (1, 0, 1)], float)
    vertices = np.concatenate([square, square + np.array([0, 0.5, 0])])
    (tmp_path / "my.obj").write_text(obj(vertices, faces))
    with pytest.raises(BadFileError, match=words) as caught:
        write_definition(str(tmp_path / "my.obj"))
    assert "\n" not in str(caught.value)


def with_buttons(count: int = 4) -> tuple[Surface, list[int]]:
    """Return a sheet and squares before it that nothing holds; and the first lines of those in the file."""
    vertices, faces = sheet()
    button = np.array(
        [(-0.02, -0.05, 0), (0.02, -0.05, 0), (0.02, -0.05, 0.04), (-0.02, -0.05, 0.04)]
    )
    places = [vertices]
    begins = []
    for number in range(count):
        first = len(vertices) + 4 * number
        places.append(button + np.array([0, 0, 0.6 + 0.2 * number]))
        begins.append(len(faces))
        faces = [*faces, [first, first + 1, first + 2, first + 3]]
    lines = [len(vertices) + 4 * count + begin + 1 for begin in begins]
    return (np.concatenate(places), faces), lines


def test_pieces_that_nothing_holds_are_counted_and_named(tmp_path: Path):
    surface, lines = with_buttons()
    (tmp_path / "my.obj").write_text(obj(*surface))
    named = ", ".join(map(str, lines[:3]))
    words = f"4 of 5 pieces are held by nothing, those of the triangles of lines {named}, …"
    with pytest.raises(BadFileError, match=words):
        write_definition(str(tmp_path / "my.obj"))
    assert not (tmp_path / "my.toml").exists()
    toml, _ = write_definition(str(tmp_path / "my.obj"), keep="largest")
    assert len(simulated(toml).mesh.positions) == 25
    # as older versions wrote it
    toml.write_text(toml.read_text().replace('keep = "largest"', ""))
    with pytest.raises(BadFileError, match=words):
        simulated(toml)
    # each held by a mover
    pins = [25 + number for number in range(16)]
    text = f"[movers.hand]\nposition = [0.0, 0.0, 1.0]\npins = {pins}\n"
    toml.write_text(toml.read_text() + text)
    assert simulated(toml).mesh.pieces().max() == 4


def test_bodies_beside_each_other_are_both_held(tmp_path: Path):
    vertices, faces = sheet()
    more = [[corner + len(vertices) for corner in face] for face in faces]
    both = np.concatenate([vertices, vertices + np.array([2, 0, 0])])
    (tmp_path / "my.obj").write_text(obj(both, faces + more))
    toml, _ = write_definition(str(tmp_path / "my.obj"))
    assert simulated(toml).mesh.pieces().max() == 1


@pytest.mark.parametrize("write", [msh_2, msh_4])
def test_two_solids_that_nothing_holds_are_no_one_body(write, tmp_path: Path):
    positions, tetrahedra = cube(1)
    small = positions * 0.5 + [1, 0, 0]
    both = np.concatenate([positions, small])
    elements = np.concatenate([tetrahedra, tetrahedra + len(positions)])
    (tmp_path / "my.msh").write_text(write(both, elements))
    with pytest.raises(BadFileError, match="2 of 2 pieces are held by nothing"):
        write_definition(str(tmp_path / "my.msh"))
    toml, _ = write_definition(str(tmp_path / "my.msh"), keep="largest")
    np.testing.assert_allclose(simulated(toml).mesh.positions, positions)


@pytest.mark.parametrize("write", [msh_2, msh_4])
def test_tetrahedra_of_either_orientation_are_the_same_body(write, tmp_path: Path):
    positions, tetrahedra = cube(2)
    bodies = []
    for corners in (tetrahedra, tetrahedra[:, [0, 2, 1, 3]]):
        (tmp_path / "my.msh").write_text(write(positions, corners))
        toml, proposal = write_definition(str(tmp_path / "my.msh"), force=True)
        assert "mended" not in dict(proposal.told)
        bodies.append(simulated(toml).body)
    assert bodies[1].volumes.min() > 0
    enclosed = np.linalg.det(positions[bodies[1].faces]).sum() / 6
    np.testing.assert_allclose(enclosed, bodies[0].volumes.sum())
    mixed = tetrahedra.copy()
    mixed[[3, 5]] = mixed[[3, 5]][:, [0, 2, 1, 3]]
    text = write(positions, mixed)
    (tmp_path / "my.msh").write_text(text)
    tail = " ".join(map(str, mixed[3] + 1))
    line = 1 + next(i for i, row in enumerate(text.splitlines()) if row.endswith(f" {tail}"))
    with pytest.raises(BadFileError, match=f"inside out, .*of lines {line}, {line + 2}"):
        write_definition(str(tmp_path / "my.msh"), force=True)


@pytest.mark.parametrize("unit", ["mm", "cm", "in"])
@pytest.mark.parametrize("shape", SURFACES)
def test_a_mesh_in_another_unit_and_y_up_is_the_same_body(shape: str, unit: str, tmp_path: Path):
    vertices, faces = SURFACES[shape]()
    scale = {"mm": 1000, "cm": 100, "in": 1 / 0.0254}[unit]
    x, y, z = (scale * vertices).T
    (tmp_path / "a.obj").write_text(obj(vertices, faces))
    (tmp_path / "b.obj").write_text(obj(np.stack([x, z, -y], axis=1), faces))
    with pytest.raises(ArgumentError, match=r"m (tall|long): in (milli|centi)metres\? --unit"):
        write_definition(str(tmp_path / "b.obj"))
    a, _ = write_definition(str(tmp_path / "a.obj"))
    b, proposal = write_definition(str(tmp_path / "b.obj"), unit=unit, up="y")
    assert not proposal.warnings
    one = simulated(a)
    other = simulated(b)
    np.testing.assert_allclose(other.mesh.positions, one.mesh.positions, atol=2e-6)
    np.testing.assert_allclose(other.masses.sum(), one.masses.sum(), rtol=1e-3)
    np.testing.assert_array_equal(other.body.pins, one.body.pins)


def test_absurd_sizes_are_asked_about_and_a_lying_cape_is_said(tmp_path: Path):
    vertices, faces = sheet()
    file = tmp_path / "my.obj"
    file.write_text(obj(1000 * vertices, faces))
    with pytest.raises(ArgumentError, match=r"1000 m tall: in millimetres\? --unit mm"):
        write_definition(str(file))
    _, proposal = write_definition(str(file), unit="m")
    assert "1000 m large" in proposal.warnings[0]
    file.write_text(obj(0.005 * vertices, faces))
    with pytest.raises(ArgumentError, match=r"0.005 m tall: scale it"):
        write_definition(str(file), force=True)
    file.write_text(obj(vertices[:, [0, 2, 1]], faces))
    _, proposal = write_definition(str(file), force=True)
    assert "--up y" in proposal.warnings[0]
    _, proposal = write_definition(str(file), force=True, up="z")
    assert not proposal.warnings


def test_options_of_meshes_are_refused_elsewhere(tmp_path: Path):
    (tmp_path / "my.csv").write_text("time,x\n0,0\n")
    with pytest.raises(
        ArgumentError, match=r"my.csv: --unit, --up are for meshes\. Leave them out"
    ):
        write_definition(str(tmp_path / "my.csv"), unit="mm", up="y")
    (tmp_path / "my.obj").write_text(obj(*sheet()))
    with pytest.raises(NeuroAnimatorError, match="up: input should be 'y' or 'z'"):
        write_definition(str(tmp_path / "my.obj"), up="x")


def test_the_proposed_number_of_transitions_takes_this_machine_an_hour(monkeypatch):
    monkeypatch.setenv("NEUROANIMATOR_CORES", "2")
    assert affordable_count(12_288, 7200) == 12_288
    assert affordable_count(12_288, 0) == 12_288
    assert affordable_count(12_288, 2 * 7200) == 6100
    assert affordable_count(12_288, 1000 * 7200) == 770


def test_next_names_the_command_that_takes_an_hour(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setenv("NEUROANIMATOR_CORES", "1")
    monkeypatch.chdir(tmp_path)
    Path("my.obj").write_text(obj(*sheet()))
    new.run("my.obj")
    assert "neuroanimator train my.toml --out my.emulator" in capsys.readouterr().out
    monkeypatch.setattr(soft, "CONSTRAINT_SECONDS", 1e-5)
    new.run("my.obj", force=True)
    told = " ".join(capsys.readouterr().out.split())
    count = re.search(r"neuroanimator generate my.toml --count (\d+) --out my.data", told)
    assert count is not None
    assert f"{int(count[1]):,} about 60 min" in told
    assert "and: neuroanimator train my.data --out my.emulator.safetensors" in told
