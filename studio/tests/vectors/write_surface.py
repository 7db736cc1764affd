"""Write what Python says of a soft body's nodes and normals, for the page's tests: run it when its shapes change.

python studio/tests/vectors/write_surface.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from neuroanimator.appearance.shapes import Shapes
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.export.morphs import surface_normals
from neuroanimator.state.placement import Placement
from neuroanimator_studio.description import describe_surface

SIDE = 13
"""Nodes along a side of the cloth."""

COUNT = 6
"""Number of shapes: no whole number of the page's groups of four."""

DIGITS = 6
"""Significant digits that are kept of every number."""


def main() -> None:
    """Write a waving square, what the page is told of it, and where its nodes and normals are in two states."""
    shapes = waving_square()
    rng = np.random.default_rng(5)
    # Position and heading, which the square goes and turns with, and amplitudes.
    states = np.concatenate([rng.normal(0, 1, (2, 4)), rng.normal(0, 0.05, (2, COUNT))], axis=1)
    # As an emulator has them: in 16 bits.
    kept = Shapes.from_tensors(shapes.tensors(), shapes.first, shapes.placement, states.shape[1])
    nodes = kept.decode(states)
    vectors = {
        "surface": describe_surface(Skeleton((), shapes=kept)),
        "states": _rounded(states),
        "nodes": _rounded(nodes.reshape(2, -1)),
        "normals": _rounded(surface_normals(kept, nodes).reshape(2, -1)),
    }
    text = json.dumps(vectors, separators=(",", ":"))
    Path(__file__).with_name("surface.json").write_text(text + "\n")


def waving_square() -> Shapes:
    """Return a square of cloth, 1 m wide, and smooth shapes that leave its upper edge alone."""
    line = np.linspace(0, 1, SIDE)
    across, down = (axis.ravel() for axis in np.meshgrid(line, line))
    mean = np.stack([across - 0.5, 0 * across, -down], axis=1)
    modes = np.zeros((COUNT, SIDE * SIDE, 3))
    for number in range(COUNT):
        wave = down * np.cos(0.6 * ((1 + number % 3) * across + number * down) + number)
        modes[number, :, (1, 0, 2)[number % 3]] = wave / np.sqrt((wave**2).mean())
    node = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    first = np.stack([node[:-1, :-1], node[1:, :-1], node[1:, 1:]], axis=-1).reshape(-1, 3)
    second = np.stack([node[:-1, :-1], node[1:, 1:], node[:-1, 1:]], axis=-1).reshape(-1, 3)
    return Shapes(mean, modes, np.concatenate([first, second]), 4, Placement(0, 3))


def _rounded(rows: np.ndarray) -> list[list[float]]:
    return [[float(f"{number:.{DIGITS}g}") for number in row] for row in rows]


if __name__ == "__main__":
    main()
