"""Pictures of the soft bodies that ship along paths they never saw: the physics above, the emulator below."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure

import neuroanimator as na
from large_bodies_cases.equal_error import (
    STEPS,
    Test,
    emulated_states,
    known_states,
    shipped,
    unseen,
)
from neuroanimator.appearance.shapes import Shapes
from neuroanimator.export.film.drawing import draw_takes
from neuroanimator.export.film.options import Film, Take
from neuroanimator.files.atomic import write_whole
from neuroanimator.state.placement import Placement
from neuroanimator.terminal import progress_bar

SHOWN = (0, STEPS // 2, STEPS - 1)
"""Super steps that are drawn: the first, the middle and the last."""

SIZE = (320, 320)
"""Width and height of each picture [pixels]."""

CAMERAS = {"cape": "back", "flag": "follow", "jelly": "follow"}
"""From where each is seen."""


def draw_sheet(names: list[str], path: Path) -> None:
    """Write a picture of each body's liveliest run to `path`."""
    figure = Figure(figsize=(2.2 * len(SHOWN) * len(names), 5.0), layout="constrained")
    parts = figure.subfigures(1, len(names), squeeze=False)[0]
    for part, name in zip(parts, names, strict=True):
        system, emulator = shipped(name)
        test = unseen(system, emulator.dt)
        run = liveliest(test)
        states = emulated_states(emulator, test)[run, 1:][list(SHOWN)]
        emulated = na.Clip(name, emulator.skeleton, np.array(SHOWN) * test.dt, states)
        part.suptitle(f"{name}: physics above, emulator below")
        axes = part.subplots(2, len(SHOWN))
        for row, clip in zip(
            axes, (of_nodes(emulated, test.truth[list(SHOWN), ..., run]), emulated), strict=True
        ):
            for column, (picture, step) in enumerate(zip(pictures(clip), SHOWN, strict=True)):
                row[column].imshow(picture)
                row[column].axis("off")
                row[column].set_title(f"{(step + 1) * test.dt:.2f} s", fontsize="small")
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=100)
    write_whole(path, picture.getvalue())


def liveliest(test: Test) -> int:
    """Return the run in which nodes move most, seen from what holds them."""
    states = known_states(test)
    ends = np.moveaxis(test.truth[-1], -1, 0)
    still = np.zeros_like(ends)
    last = test.system.encode(ends, still, test.paths[-1].T, test.given.T)
    shapes = test.system.shapes.amplitudes
    return int(((last - states)[:, shapes] ** 2).sum(axis=1).argmax())


def of_nodes(clip: na.Clip, nodes: Float[np.ndarray, "F N 3"]) -> na.Clip:
    """Return `clip` with its surface's `nodes` [m] in each frame; what no shape of the emulator can tell is seen, too."""
    shapes = clip.skeleton.shapes
    assert shapes is not None
    every = np.eye(len(nodes))
    own = Shapes(np.zeros_like(nodes[0]), nodes, shapes.faces, clip.states.shape[1], Placement())
    states = np.concatenate([clip.states, every], axis=1)
    return replace(clip, states=states, skeleton=replace(clip.skeleton, shapes=own))


def pictures(clip: na.Clip) -> list[UInt8[np.ndarray, "H W 3"]]:
    """Return a picture of each frame, in the middle of which the body is."""
    takes = []
    for state in clip.states:
        twice = np.stack([state, state])  # a clip of one frame has no rate
        takes.append(Take((replace(clip, times=np.array([0.0, 1.0]), states=twice),)))
    with progress_bar("drawing", 2 * len(takes)) as bar:
        drawn = list(draw_takes(takes, Film(SIZE, CAMERAS[clip.name]), bar))
    return drawn[::2]
