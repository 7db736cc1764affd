"""Gauges that draw a system without bodies: a pointer for each angle, a slider for every other number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.clip import Clip
from neuroanimator.appearance.skeleton import Bone, Shape, Skeleton
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.state.layout import entry_names, entry_units
from neuroanimator.state.links import Joint, Numbers
from neuroanimator.state.rotation import NO_ROTATION

MAX_GAUGES = 24
"""Maximum number of state entries shown; more would be too small to read."""

GAUGES_PER_ROW = 6
"""Number of gauges side by side before the next row begins above."""

PITCH = 1.2
"""Distance between the middles of neighbouring gauges [m]."""

HEIGHT = 0.75
"""Height of the middle of the lowest row above the ground [m]."""

REACH = 0.45
"""Length of a pointer, and half that of a slider's rail [m]."""

THICKNESS = 0.02
"""Half the thickness of fixed parts [m]."""

BEFORE = 0.05
"""Distance of moving parts in front of fixed ones [m], towards a viewer who looks along y."""

TICKS = 12
"""Number of marks around a dial; the one at angle 0 is longer."""

ANGLE = "rad"
"""Unit of the numbers that get a pointer."""

FACE: Numbers = (0.80, 0.82, 0.85, 1.0)
MARK: Numbers = (0.35, 0.38, 0.42, 1.0)
HAND: Numbers = (0.87, 0.42, 0.13, 1.0)

FACING: Numbers = (float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0)
"""The quaternion that turns a cylinder's axis from z to y, towards the viewer."""

TOWARDS_VIEWER: Numbers = (0.0, -1.0, 0.0)
"""The axis of a pointer: seen from there, a growing angle turns it anticlockwise."""

UP: Numbers = (0.0, 0.0, 1.0)
"""The axis of a slider."""


def drawable(clip: Clip, emulator: Emulator, *, ranges_from: Clip | None = None) -> Clip:
    """Return `clip` if it shows bodies; for a step function or recordings, gauges that show its numbers."""
    if clip.skeleton.bones:
        return clip
    return as_gauges(clip, emulator, ranges_from=ranges_from)


def as_gauges(clip: Clip, emulator: Emulator, *, ranges_from: Clip | None = None) -> Clip:
    """Return a clip of gauges that show the motion in `clip`, which belongs to `emulator`'s system.

    A pointer hangs down at angle 0 and turns anticlockwise as the angle grows. A slider runs from the
    lowest to the highest number in the clip, or in `ranges_from`: clips shown together need the same ranges.
    Rates of other numbers have no gauge, since they are visible as motion.
    """
    ranges = clip.states if ranges_from is None else ranges_from.states
    shown = shown_entries(emulator)
    names = entry_names(emulator.state)
    units = entry_units(emulator.state)
    bones: list[Bone] = []
    # The first number never moves: see `_face`.
    columns = [np.zeros(len(clip.states))]
    for place, entry in enumerate(shown):
        name = names[entry].replace("[", ".").rstrip("]")  # brackets are not for bones
        middle = _middle(place, len(shown))
        numbers = clip.states[:, entry]
        if units[entry] == ANGLE:
            bones += _pointer(name, middle, len(columns))
            columns.append(numbers)
        else:
            bones += _slider(name, middle, len(columns))
            columns.append(_along_rail(numbers, ranges[:, entry]))
    return replace(clip, skeleton=Skeleton(tuple(bones)), states=np.stack(columns, axis=1))


def shown_entries(emulator: Emulator) -> list[int]:
    """Return the state entries that have a gauge: the first `MAX_GAUGES` that are not the rate of another."""
    rates = {rate for _, rate in emulator.rates}
    entries = [entry for entry in range(emulator.state.size) if entry not in rates]
    return entries[:MAX_GAUGES]


def _middle(place: int, count: int) -> Numbers:
    """Return the middle of gauge number `place` of `count` [m]; the first is on the upper left."""
    row, column = divmod(place, GAUGES_PER_ROW)
    last_row = (count - 1) // GAUGES_PER_ROW
    return (PITCH * column, 0.0, HEIGHT + PITCH * (last_row - row))


def _along_rail(
    numbers: Float[np.ndarray, " F"], shown: Float[np.ndarray, " R"]
) -> Float[np.ndarray, " F"]:
    """Return `numbers` as heights above a rail's middle [m]: the range of `shown` spans the rail."""
    low = shown.min()
    high = shown.max()
    if high == low:
        return np.zeros(len(numbers))
    return REACH * (2 * (numbers - low) / (high - low) - 1)


def _pointer(name: str, middle: Numbers, entry: int) -> list[Bone]:
    """Return a dial, and the pointer on it that the state entry turns."""
    dial = [Shape("cylinder", (REACH, THICKNESS), (0.0, 0.0, 0.0), FACING, FACE)]
    for tick in range(TICKS):
        dial.append(_tick(2 * np.pi * tick / TICKS, is_zero=tick == 0))
    # Down from the middle, so that it hangs at angle 0.
    hand = Shape("capsule", (0.025, REACH / 2), (0.0, 0.0, -REACH / 2), NO_ROTATION, HAND)
    pin = Shape("sphere", (0.05,), (0.0, 0.0, 0.0), NO_ROTATION, HAND)
    turn = Joint("hinge", entry, TOWARDS_VIEWER, (0.0, 0.0, 0.0))
    return [_face(f"{name} dial", middle, dial), _mover(name, middle, turn, [hand, pin])]


def _tick(angle: float, *, is_zero: bool) -> Shape:
    """Return the mark for an angle [rad] on a dial."""
    half_length = 0.06 if is_zero else 0.03
    radius = REACH - half_length
    position = (float(np.sin(angle)) * radius, -THICKNESS, -float(np.cos(angle)) * radius)
    orientation = (float(np.cos(angle / 2)), 0.0, -float(np.sin(angle / 2)), 0.0)
    return Shape("box", (0.008, 0.008, half_length), position, orientation, MARK)


def _slider(name: str, middle: Numbers, entry: int) -> list[Bone]:
    """Return a rail with its ends, and the knob on it that the state entry moves."""
    rail = [Shape("box", (0.05, THICKNESS, REACH), (0.0, 0.0, 0.0), NO_ROTATION, FACE)]
    for end in (-REACH, REACH):
        rail.append(Shape("box", (0.14, THICKNESS, 0.01), (0.0, 0.0, end), NO_ROTATION, MARK))
    knob = Shape("box", (0.12, 0.03, 0.04), (0.0, 0.0, 0.0), NO_ROTATION, HAND)
    slide = Joint("slide", entry, UP, (0.0, 0.0, 0.0))
    return [_face(f"{name} rail", middle, rail), _mover(name, middle, slide, [knob])]


def _face(name: str, middle: Numbers, shapes: list[Shape]) -> Bone:
    """Return the fixed part of a gauge.

    Cameras look at what can move, so it is attached to a joint whose number never changes.
    """
    held = Joint("slide", 0, UP, (0.0, 0.0, 0.0))
    return Bone(name, -1, middle, NO_ROTATION, (held,), tuple(shapes))


def _mover(name: str, middle: Numbers, joint: Joint, shapes: list[Shape]) -> Bone:
    """Return the moving part of a gauge."""
    x, y, z = middle
    return Bone(name, -1, (x, y - BEFORE, z), NO_ROTATION, (joint,), tuple(shapes))
