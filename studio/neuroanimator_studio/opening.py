"""The motion a system is shown with when nobody says anything: worth a look, and never random twitching if that can be helped."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from neuroanimator import Emulator, NeuroAnimatorError, SearchOptions, System, is_reached
from neuroanimator.authoring import Drive, random_drive, shipped_drive
from neuroanimator.control import goal_start, synthesise_goal
from neuroanimator_studio.description import body_size

PERIOD = 12.0
"""Time after which the movers of a soft body are where they began [s]: the motion goes on without a jump."""

VISITS = 3
"""How often in that time what strikes a soft body comes to its middle."""

SWAY = 0.06
"""How far movers sway with each of their waves, at most, over the size of the body: what `new` proposes reaches further."""

TURN = 0.15
"""How far those that turn do so with each of their waves, at most [rad]."""

WAVES = (1, 2, 3)
"""How often the waves of swaying come in `PERIOD`."""

SHAKE = 0.25
"""How far what holds a solid is shaken with each of its waves, at most, over its size: carried slowly, none wobbles."""

SHAKES = (4, 7, 11)
"""How often these waves come in `PERIOD`."""

MIXTURE = 1.9
"""Difference between axes in what they have of each wave, so that no two move alike [rad]."""

WELL_WITHIN = 0.8
"""Share of its bounds that a mover's velocity has at most."""


def opening_drive(emulator: Emulator, system: System) -> Drive:
    """Return what `animate` shows of what ships and of a body with a gait; of another what reaches a goal of `system`.

    A goal with a start of its own comes first: its motion goes somewhere. Of a soft body movers wander.
    """
    if emulator.frame.shape_contacts is not None:
        return wander(emulator)
    shipped = shipped_drive(emulator)
    if shipped is not None:
        return shipped
    if emulator.gait is None:
        for name in _goals_away_from_start(system):
            try:
                found = synthesise_goal(
                    emulator, system, name, options=SearchOptions(refinements=0)
                )
            except NeuroAnimatorError:
                continue  # of somebody's own system: it may be out of reach
            start = goal_start(system, name)
            # What the physics corrected may miss on the emulator, which is what is shown.
            for controls in (found.controls, found.descent.controls):
                states = np.asarray(emulator.rollout(start, controls), float)
                if is_reached(system, name, states[-1]):
                    return Drive(start, np.array(controls, float))
    return random_drive(emulator, None, 0, system=system)


def wander(emulator: Emulator) -> Drive:
    """Return smooth paths of movers, all of which end where they began: colliders come to the body, what holds it sways."""
    contacts = emulator.frame.shape_contacts
    shapes = emulator.skeleton.shapes
    assert contacts is not None
    assert shapes is not None
    rest = np.array(emulator.rest, float)
    middle = shapes.decode(rest).mean(axis=0)
    size = body_size(emulator.spec)
    steps = round(PERIOD / emulator.dt)
    turns = np.linspace(0, 2 * np.pi, steps + 1)[:, None]
    nearness = (1 - np.cos(VISITS * turns)) / 2
    striking = {collider.mover for collider in (*contacts.capsules, *contacts.boxes)}
    paths = np.zeros((steps + 1, contacts.rate_size))
    is_solid = _is_closed(shapes.faces)
    for number, mover in enumerate(contacts.movers):
        axes = mover.rate + np.arange(mover.rate_size)
        is_shaken = is_solid and number == contacts.anchor
        reach = np.full(mover.rate_size, (SHAKE if is_shaken else SWAY) * size)
        reach[3:4] = TURN
        reach[4:] = 0.0  # about one axis, so that it ends where it began
        for waves in SHAKES if is_shaken else WAVES:
            paths[:, axes] += reach * np.cos(MIXTURE * axes + waves) * np.sin(waves * turns)
        if is_shaken:
            # From rest to rest: it wobbles on after each time.
            paths[:, axes] *= np.sin(turns / 2) ** 2
        if number in striking and number != contacts.anchor:
            paths[:, axes[:3]] += nearness * (middle - mover.placement.origin(rest))
    velocities = np.diff(paths, axis=0) / emulator.dt
    return Drive(rest, _well_within(emulator, velocities))


def _is_closed(faces: Int[np.ndarray, "F 3"]) -> bool:
    """Return whether a surface is that of a solid: each edge is one of two triangles."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return bool((counts == 2).all())


def _well_within(
    emulator: Emulator, velocities: Float[np.ndarray, "T C"]
) -> Float[np.ndarray, "T C"]:
    """Return `velocities`, made smaller along each axis so that the largest is well within the bounds."""
    allowed = WELL_WITHIN * np.minimum(np.abs(emulator.bounds.low), np.abs(emulator.bounds.high))
    largest = np.maximum(np.abs(velocities).max(axis=0), 1e-9)
    return velocities * np.minimum(1, allowed / largest)


def _goals_away_from_start(system: System) -> list[str]:
    """Return the names of goals that are not reached where they begin, those with a start of their own first."""
    names = []
    for name in sorted(system.goals, key=lambda name: not system.goals[name].start):
        if not is_reached(system, name, goal_start(system, name)):
            names.append(name)
    return names
