"""The dolphin's motion to look at first: it gathers speed, leaves the water, dives in nose first and swims on."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator import (
    Bounds,
    DescentOptions,
    Emulator,
    Objective,
    effort,
    reach_heading,
    reach_height,
    smoothness,
    stay_upright,
    synthesise,
)
from neuroanimator.animation.motion import Drive
from neuroanimator.control.descent.parametrisation import Steered
from neuroanimator.systems.system import System

DEPTH = 4.2
"""It starts so far under its rest [m], for a run-up."""

SECONDS = 4.2
"""Time in which it leaps and dives in again [s]."""

TEMPO = 1.5
"""Its strokes are so many times as quick as its gait's."""

STROKES = 0.8
"""They are so strong, over the gait's."""

BEND_TIMES = (0.0, 0.8, 2.4, SECONDS)
"""When its back is bent as follows [s]."""

BENDS = (0.0, 0.32, 0.0, -0.09)
"""How far its back is bent upward in the first guess, over the controls' range."""

TOP = 3.3
"""When it is highest [s]."""

HEIGHT = 0.8
"""All of it, its flukes included, is then so high over the water [m]."""

ENTRY = 3.85
"""When it dives in [s]."""

STEEPNESS = np.radians(50.0)
"""How steeply it then points downward [rad]."""

COURSES = 7
"""Bends of its back that the descent may change, one after the other."""

NOT_PULLING = 1e-3
"""Range of muscles that are none of the gait's: what pulls left and right alike would twist it in flight."""

AFTERWARDS = 0.6
"""Time it then swims on [s]."""


def leap_drive(emulator: Emulator, system: System) -> Drive:
    """Return start and controls of the leap, found through the emulator (examples/09_leap.py)."""
    gait = system.gait
    cloud = system.structure.cloud
    assert gait is not None
    assert cloud is not None
    steps = round(SECONDS / emulator.dt)
    start = np.array(system.rest, float)
    start[2 : 3 * cloud.count : 3] -= DEPTH
    pulls = np.array(gait.amplitudes) != 0
    bounds = Bounds.symmetric(np.where(pulls, 1.0, NOT_PULLING))
    times = np.arange(steps) * emulator.dt
    bend = np.interp(times, BEND_TIMES, BENDS)
    strokes = STROKES * gait.controls(steps, emulator.dt, bounds, tempo=TEMPO)
    first = strokes + bend[:, None] * np.sign(gait.amplitudes)
    parametrisation = Steered.of(steps, emulator.dt, gait.period / TEMPO, COURSES, bounds)
    found = synthesise(
        emulator,
        system,
        _objective(system),
        start,
        steps=steps,
        options=DescentOptions(parametrisation=parametrisation, first=first),
        corrections=8,
        refinements=0,
    )
    onward = gait.controls(round(AFTERWARDS / emulator.dt), emulator.dt, emulator.bounds)
    controls: Float[np.ndarray, "T C"] = np.concatenate([found.controls, onward])
    return Drive(start, emulator.bounds.clip(controls))


def _objective(system: System) -> Objective:
    nose_first = (float(np.cos(STEEPNESS)), 0.0, -float(np.sin(STEEPNESS)))
    return Objective.of(
        effort(0.003),
        smoothness(0.0003),
        stay_upright(system, may_pitch=True),
        reach_height(system, HEIGHT, within=0.1, at=TOP),
        reach_heading(system, nose_first, within=0.13, at=ENTRY),
    )
