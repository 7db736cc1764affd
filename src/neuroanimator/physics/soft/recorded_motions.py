"""Recorded motions of all movers, by a character's GLB file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from neuroanimator.animation.recorded_path import paths_of_nodes
from neuroanimator.errors import ArgumentError
from neuroanimator.files.glb import read_glb
from neuroanimator.systems.movers import Motions, Movers

MOTION_STEP = 1 / 30
"""Time between two poses [s]."""

SLACK = 1.01
"""Ratio of a motion's speed to its mover's up to which it is allowed: files round."""


def recorded_motions(path: Path, movers: Movers) -> Motions:
    """Return the motion of the nodes of a GLB file that are called as `movers`; the other movers stay.

    Raises ArgumentError if none is, or if one is faster than its mover may be, BadFileError if the file is faulty.
    """
    paths = paths_of_nodes(read_glb(path), path, movers.names)
    begin = max(found.times[0] for found in paths.values())
    end = min(found.times[-1] for found in paths.values())
    times = np.arange(begin, end, MOTION_STEP)
    if len(times) < 2:
        raise ArgumentError(f"motions: {path} lasts {end - begin:g} s; wanted a few minutes.")
    poses = np.repeat(movers.rest[None], len(times), axis=0)
    for name, found in paths.items():
        place = movers.places[movers.names.index(name)]
        poses[:, place.entries] = found.poses(place, movers.rest[place.entries], times)
    motions = Motions(poses, MOTION_STEP)
    rates = motions.rates(movers.quaternions)
    for name, place in zip(movers.names, movers.places, strict=True):
        fastest = np.abs(rates[:, place.rates]).max(axis=0)
        excess = fastest / movers.speed[place.rates]
        if excess.max() > SLACK:
            axis = int(excess.argmax())
            key, unit = ("speed", "m/s") if axis < 3 else ("turn_speed", "rad/s")
            raise ArgumentError(
                f"motions: {name} moves at up to {fastest[axis]:.3g} {unit} in {path}, and its {key} is "
                f"{movers.speed[place.rates][axis]:g}. Raise it, or look for jumps, and for other units than metres."
            )
    return motions
