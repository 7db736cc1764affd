"""Movers proposed from a character's GLB file: its bones, with capsules around the points of the skin that each moves."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.glb_rig import Rig, RigBone
from neuroanimator.animation.recorded_path import mover_name
from neuroanimator.definitions.soft import MAX_MOVERS, MoverTable
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import one_line
from neuroanimator.files.glb import read_glb
from neuroanimator.files.names import refuse_twins
from neuroanimator.physics.soft.recorded_motions import recorded_motions
from neuroanimator.physics.soft.soft_body import Points
from neuroanimator.state.mover_poses import FREELY
from neuroanimator.systems.movers import PLAYED, Movers

SMALL = 0.08
"""Length of a bone, over the character's size, below which its points count as those of the bone above: fingers, an eye."""

TRIMMED = 2.0
"""Share of the points at each end of an extent that are left out [%]."""

FLAT = 1.3
"""Width over thickness from which a bone is cut into slices across its length, each with a capsule of its own: a trunk."""

MOST_SLICES = 4
"""Maximum number of slices."""

THINNEST = 0.7
"""Smallest radius to which a capsule shrinks so that the cloth begins outside, over its own."""

SHORTER = (0.0, 0.2, 0.4, 0.6)
"""Shares of its length by which it is made shorter for that, at either end."""

USUAL_SPEED, USUAL_TURN_SPEED = 2.0, 6.0
"""Largest speeds of a bone [m/s, rad/s] if no animation tells them."""

REACH, TURN_REACH = 0.1, 0.3
"""Distance [m] and angle [rad] from rest to which bones are moved beside their motions."""

FASTEST = 1e6
"""Speed of movers before their motions are known [m/s, rad/s]."""

Capsule = tuple[float, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]
"""Radius, and the centres of both ends [m]."""


def propose_movers(
    path: Path, nodes: Points, pins: np.ndarray, margin: float
) -> tuple[dict[str, dict[str, Any]], list[tuple[str, str]], bool]:
    """Return (tables of movers by name, rows for the screen, whether the file has an animation that they can follow).

    The bone nearest to the pinned `nodes` [m] holds them; the others begin `margin` away from its capsules. BadFileError
    for a file without bones, or whose bones are in the cloth.
    """
    file = read_glb(path)
    try:
        bones = _large_bones(Rig(file).bones())
    except ValueError as error:
        raise BadFileError(f"{path}: {one_line(error)}.") from error
    if not bones:
        raise BadFileError(
            f"{path}: no bones that move a skin. Export the character with its armature and its skin."
        )
    refuse_twins((mover_name(bone.name) for bone in bones), f"{path}: bones")
    held = nodes[pins].mean(axis=0)
    holder = min(bones, key=lambda bone: np.linalg.norm(bone.points - held, axis=1).min())
    free = np.delete(nodes, pins, axis=0)
    tables = {}
    for bone in bones:
        around = free - bone.position
        colliders = [_outside(capsule, around, margin) for capsule in _capsules(bone)]
        if bone is not holder and not any(colliders):
            continue
        tables[mover_name(bone.name)] = {
            "position": np.round(bone.position, 6).tolist(),
            "reach": [REACH] * 3,
            "turns": FREELY,
            "turn_reach": TURN_REACH,
            "pins": pins.tolist() if bone is holder else [],
            "colliders": [table for table in colliders if table],
        }
    has_motions = bool(file.objects("animations"))
    speeds = dict.fromkeys(tables, (USUAL_SPEED, USUAL_TURN_SPEED))
    told = [
        (
            "movers",
            f"{len(tables)} bones of {path.name}; {mover_name(holder.name)} holds {len(pins)} nodes",
        )
    ]
    if has_motions:
        found = {
            name: MoverTable(**table, speed=(FASTEST, FASTEST, FASTEST), turn_speed=FASTEST)
            for name, table in sorted(tables.items())
        }
        movers = Movers(found)
        motions = recorded_motions(path, movers)
        fastest = PLAYED[1] * np.abs(motions.rates(movers.quaternions)).max(axis=0)
        for name, place in zip(movers.names, movers.places, strict=True):
            moving = fastest[place.rates]
            speeds[name] = (_up(moving[:3].max()), _up(moving[3:].max()))
        told.append(("motions", f"{len(motions.poses) * motions.dt:.0f} s of {path.name}"))
    for name, (speed, turn_speed) in speeds.items():
        tables[name] |= {"speed": [speed] * 3, "turn_speed": turn_speed}
    return tables, told, has_motions


def _up(speed: float) -> float:
    """Return a speed rounded up to tenths, for a TOML file."""
    return round(np.ceil(10 * max(speed, 0.1)) / 10, 1)


def _large_bones(bones: list[RigBone]) -> list[RigBone]:
    """Return the largest bones, those of small ones with the points of the bones above; none twice by name."""
    known = {bone.name: bone for bone in bones if bone.name}
    points = np.concatenate([bone.points for bone in bones]) if bones else np.zeros((1, 3))
    least = SMALL * float(np.ptp(points, axis=0).max())
    for bone in reversed(bones):  # children come after their parents in most files
        above = known.get(bone.above)
        own = known.get(bone.name)
        if own is None or _extent(own) >= least or above is None:
            continue
        known[bone.above] = above._replace(points=np.concatenate([above.points, own.points]))
        del known[bone.name]
    return sorted(known.values(), key=_extent, reverse=True)[:MAX_MOVERS]


def _extent(bone: RigBone) -> float:
    return float(np.ptp(bone.points, axis=0).max())


def _capsules(bone: RigBone) -> list[Capsule]:
    """Return the capsules around a bone's points, from its position [m]."""
    points = bone.points - bone.position
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
    low, high = np.percentile((points - middle) @ axes.T, (TRIMMED, 100 - TRIMMED), axis=0)
    length, width, thickness = high - low
    count = 1
    if width > FLAT * thickness:
        count = int(np.clip(np.ceil(length / thickness), 1, MOST_SLICES))
    along = (points - middle) @ axes[0]
    cuts = np.linspace(low[0], high[0], count + 1)
    capsules = []
    for begin, end in pairwise(cuts):
        slice_points = points[(along >= begin) & (along <= end)]
        if len(slice_points) > 3:
            capsules.append(_capsule(slice_points, axes))
    return capsules


def _capsule(points: Points, axes: Float[np.ndarray, "3 3"]) -> Capsule:
    """Return a capsule along the longest of three `axes` of the points, as thick as they are on average across it."""
    low, high = np.percentile(points @ axes.T, (TRIMMED, 100 - TRIMMED), axis=0)
    half = (high - low) / 2
    longest = int(half.argmax())
    radius = min(float(np.delete(half, longest).mean()), float(half[longest]))
    middle = (low + high) / 2 @ axes
    away = (half[longest] - radius) * axes[longest]
    return radius, middle - away, middle + away


def _outside(capsule: Capsule, nodes: Points, margin: float) -> dict[str, Any]:
    """Return a capsule as a table, thinner or shorter so that the free `nodes` begin outside; empty if that is not enough."""
    whole, first, last = capsule
    for share in SHORTER:
        cut = share * (last - first)
        for start, end in ((first + cut, last), (first, last - cut)):
            radius = min(whole, _distance(nodes, start, end) - margin)
            if radius >= THINNEST * whole:
                ends = {"start": np.round(start, 4).tolist(), "end": np.round(end, 4).tolist()}
                return {"radius": round(radius, 4)} | ends
    return {}


def _distance(nodes: Points, start: Float[np.ndarray, " 3"], end: Float[np.ndarray, " 3"]) -> float:
    """Return the least distance of `nodes` from the line between two points [m]."""
    along = end - start
    squared = max(float(along @ along), np.finfo(float).tiny)
    share = ((nodes - start) @ along / squared).clip(0, 1)
    return float(np.linalg.norm(nodes - start - share[:, None] * along, axis=1).min())
