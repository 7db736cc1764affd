"""Left and right of a solid: the nodes, tetrahedra and muscles that swap when Y is reversed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.physics.soft.mesh import Mesh
from neuroanimator.state.structure import REVERSE_Y, Mirror

NEAR = 1e-5
"""Largest distance of a node from the mirror image of its partner, over the size of the mesh: files round positions."""


def mirror_of(mesh: Mesh, along: Mapping[str, tuple[float, ...]]) -> Mirror | None:
    """Return the partners of nodes and of muscles; None if `mesh` is not its own mirror image.

    Muscles are groups of the mesh, each with the direction along which it shortens.
    """
    # Imported here, as in `recorded.velocities`: every system's loading would wait for it.
    from scipy.spatial import cKDTree

    muscles = list(along)
    within = NEAR * float(np.ptp(mesh.positions, axis=0).max())
    apart, partners = cKDTree(mesh.positions).query(mesh.positions * REVERSE_Y)
    if apart.max() > within or (partners[partners] != np.arange(len(partners))).any():
        return None
    swapped = _places(mesh.elements, partners[mesh.elements])
    if swapped is None or mesh.members is None or not {*muscles} <= {*mesh.groups}:
        return None
    controls = []
    for name in muscles:
        images = np.unique(mesh.members[swapped[mesh.members == mesh.groups.index(name)]])
        if len(images) != 1 or images[0] < 0 or mesh.groups[images[0]] not in muscles:
            return None
        partner = mesh.groups[images[0]]
        apart = np.cross(np.multiply(along[name], REVERSE_Y), along[partner])
        if np.abs(apart).max() > NEAR * np.linalg.norm(along[name]) * np.linalg.norm(
            along[partner]
        ):
            return None
        controls.append(muscles.index(partner))
    return Mirror(tuple(partners.tolist()), tuple(controls))


def _places(
    elements: Int[np.ndarray, "E 4"], images: Int[np.ndarray, "E 4"]
) -> Int[np.ndarray, " E"] | None:
    """Return the number of the element that each image is; None if one is none."""
    known = {tuple(row): number for number, row in enumerate(np.sort(elements, axis=1).tolist())}
    found = [known.get(tuple(row), -1) for row in np.sort(images, axis=1).tolist()]
    return None if -1 in found else np.array(found)


def reflected(vectors: Float[np.ndarray, "*B N 3"], mirror: Mirror) -> Float[np.ndarray, "*B N 3"]:
    """Return what the nodes' positions or displacements are in the mirror."""
    return vectors[..., list(mirror.points), :] * REVERSE_Y.astype(vectors.dtype)


def odd_modes(modes: Float[np.ndarray, "K N 3"], mirror: Mirror) -> tuple[bool, ...]:
    """Return whether each mode changes its sign in the mirror, rather than stays."""
    return tuple(((modes * reflected(modes, mirror)).sum(axis=(1, 2)) < 0).tolist())
