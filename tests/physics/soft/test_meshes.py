"""Soft bodies made from meshes: what a material says holds for any mesh of it."""

from __future__ import annotations

import numpy as np
import pytest
from jelly_mesh import cube
from soft_bodies import poses_of

from neuroanimator.definitions.soft import ClothTable, SolidTable
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.physics.soft.mesh import Mesh
from neuroanimator.physics.soft.meshes import cloth_body, solid_body
from neuroanimator.physics.soft.program import SoftProgram
from neuroanimator.physics.soft.soft_body import Air, SoftBody

NO_PINS = np.zeros(0, int)


def strip(columns, rows, width=0.2, length=0.6):
    """Return nodes and faces of a strip that hangs along -Z; its first `columns` nodes are its upper end."""
    x, z = np.meshgrid(np.linspace(0, width, columns), -np.linspace(0, length, rows))
    nodes = np.arange(columns * rows).reshape(rows, columns)
    a, b, c, d = (
        part.ravel() for part in (nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:])
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x.ravel(), 0 * x.ravel(), z.ravel()], axis=1), faces


def box(cells: int = 2, size: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes and tetrahedra of a cube that begins at the origin."""
    positions, tetrahedra = cube(cells, size)
    return positions + np.array([size / 2, size / 2, 0.0]), tetrahedra


def at_rest(body: SoftBody) -> np.ndarray:
    """Return positions after four seconds in thick air."""
    still = np.zeros_like(body.positions)
    path, _ = SoftProgram(body, dtype=np.float64).play(
        body.positions, still, poses_of(np.zeros((121, 1, 4))), 1 / 30, 240
    )
    return path[-1]


def test_a_hanging_cloth_stretches_by_its_weight_whatever_its_mesh():
    """By ρ g L² / (2 Y), less what its held end keeps it from narrowing."""
    material = ClothTable(density=0.5, stretch=50.0, bend=0.0001)
    stretches = []
    for columns, rows in ((4, 10), (6, 16), (8, 22)):
        positions, faces = strip(columns, rows)
        body = cloth_body(Mesh(positions, faces), material, np.arange(columns), air=Air(drag=4.0))
        assert body.masses.sum() == pytest.approx(0.5 * 0.2 * 0.6)
        stretches.append(-0.6 - at_rest(body)[-columns:, 2].mean())
    expected = 0.5 * 9.81 * 0.6**2 / (2 * 50.0)
    np.testing.assert_allclose(stretches, expected, rtol=0.05)


def test_a_solid_weighs_what_it_holds_and_its_surface_is_closed():
    positions, tetrahedra = box()
    body = solid_body(Mesh(positions, tetrahedra), SolidTable(), NO_PINS)
    assert body.masses.sum() == pytest.approx(1.0)
    corners = positions[body.faces]
    enclosed = np.linalg.det(corners).sum() / 6
    assert enclosed == pytest.approx(1e-3)


def spoilt(change):
    positions, faces = strip(3, 3)
    return change(positions, faces)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p, f: (np.vstack([p, [9, 9, 9]]), f, NO_PINS), "no corners of anything: nodes 9"),
        (
            lambda p, f: (np.vstack([p, p[:1]]), np.vstack([f, [9, 1, 4]]), NO_PINS),
            "at the place of others: nodes 9",
        ),
        (lambda p, f: (p, np.vstack([f, [0, 1, 2]]), NO_PINS), "without area: triangles 8"),
        (
            lambda p, f: (p, np.vstack([f, f[:1]]), NO_PINS),
            "triangles .* share",
        ),
        (lambda p, f: (p, np.vstack([f, [4, 0, 8]]), NO_PINS), "triangles .* share the edge"),
        (lambda p, f: (p, f + 1, NO_PINS), "wanted corners among its 9 nodes"),
        (lambda p, f: (p * np.nan, f, NO_PINS), "is not finite"),
        (lambda p, f: (p, f, np.array([9])), "pins: 9 are not nodes"),
    ],
)
def test_a_mesh_that_is_no_surface_is_refused_by_name(change, message):
    positions, faces, pins = spoilt(change)
    if message == "triangles .* share the edge":
        positions = positions + np.array([0, 1.0, 0]) * np.arange(9)[:, None] ** 2 * 0.01
    with pytest.raises(NeuroAnimatorError, match=message):
        cloth_body(Mesh(positions, faces), ClothTable(), pins)


def test_a_tetrahedron_that_is_inside_out_is_refused():
    positions, tetrahedra = box(1)
    tetrahedra[2] = tetrahedra[2][[1, 0, 2, 3]]
    with pytest.raises(NeuroAnimatorError, match="inside out, unlike others: tetrahedra 2"):
        solid_body(Mesh(positions, tetrahedra), SolidTable(), NO_PINS)


def test_tetrahedra_that_overlap_are_refused():
    """As at the root of a fin that is swept back further than its rows are apart."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.3, 0.3, 0.5]], float)
    tetrahedra = np.array([[0, 1, 2, 3], [0, 1, 2, 4]])
    with pytest.raises(NeuroAnimatorError, match="so that they overlap: tetrahedra 0, 1"):
        solid_body(Mesh(positions, tetrahedra), SolidTable(), NO_PINS)
    positions[4, 2] = -0.5
    tetrahedra[1] = [1, 0, 2, 4]
    assert len(solid_body(Mesh(positions, tetrahedra), SolidTable(), NO_PINS).faces) == 6
