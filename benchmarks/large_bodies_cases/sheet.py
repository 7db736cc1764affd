"""Pictures of the soft bodies that ship along paths they never saw: the physics above, the emulator below."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from large_bodies_cases.equal_error import (
    STEPS,
    Test,
    emulated_states,
    known_states,
    shipped,
    unseen,
)
from neuroanimator.files.atomic import write_whole

SHOWN = (0, STEPS // 2, STEPS - 1)
"""Super steps that are drawn: the first, the middle and the last."""

LIGHT = np.array([0.4, 0.7, 0.6])
"""Direction towards the light."""

LOOK = {"cape": (12, 160), "flag": (8, -60), "jelly": (18, -60)}
"""Elevation and azimuth of the camera [degrees]."""

COLOUR = (0.75, 0.16, 0.16)


def draw_sheet(names: list[str], path: Path) -> None:
    """Write a picture of each body's liveliest run to `path`."""
    figure = Figure(figsize=(3.0 * len(SHOWN) * len(names), 6.4), layout="constrained")
    parts = figure.subfigures(1, len(names), squeeze=False)[0]
    for part, name in zip(parts, names, strict=True):
        system, emulator = shipped(name)
        test = unseen(system, emulator.dt)
        run = liveliest(test)
        emulated = system.shapes.decode(emulated_states(emulator, test)[run, 1:])
        part.suptitle(f"{name}: physics above, emulator below")
        for row, nodes in enumerate((test.truth[..., run], emulated)):
            for column, step in enumerate(SHOWN):
                place = row * len(SHOWN) + column + 1
                axes = part.add_subplot(2, len(SHOWN), place, projection="3d")
                draw(axes, nodes[step], test.truth[step, ..., run], system.shapes.faces, name)
                axes.set_title(f"{(step + 1) * test.dt:.2f} s", fontsize="small")
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=70)
    write_whole(path, picture.getvalue())


def liveliest(test: Test) -> int:
    """Return the run in which nodes move most, seen from what holds them."""
    states = known_states(test)
    ends = np.moveaxis(test.truth[-1], -1, 0)
    still = np.zeros_like(ends)
    last = test.system.encode(ends, still, test.paths[-1].T, test.given.T)
    shapes = test.system.shapes.amplitudes
    return int(((last - states)[:, shapes] ** 2).sum(axis=1).argmax())


def draw(
    axes: Any,
    nodes: Float[np.ndarray, "N 3"],
    centred: Float[np.ndarray, "N 3"],
    faces: Int[np.ndarray, "F 3"],
    name: str,
) -> None:
    """Draw a surface in plain light; pictures of both sides show the same part of space."""
    corners = nodes[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = 0.35 + 0.65 * np.abs(normals @ LIGHT) / np.linalg.norm(LIGHT)
    colours = np.clip(light[:, None] * np.array(COLOUR), 0, 1)
    axes.add_collection3d(
        Poly3DCollection(corners, facecolors=colours, edgecolors=colours, linewidths=0.4)
    )
    middle = (centred.min(axis=0) + centred.max(axis=0)) / 2
    half = 0.45 * np.ptp(centred, axis=0).max()
    for axis, centre in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{axis}lim")(centre - half, centre + half)
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(*LOOK[name])
    axes.axis("off")
