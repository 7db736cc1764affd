"""Read the motion that a body should follow: a table of its states, one control apart, checked against the body."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.control.policies.reference_motion import (
    MAX_FRAMES,
    ORIENTATION,
    POSITION,
    TURN,
    ReferenceMotion,
)
from neuroanimator.definitions.follow import FollowTable
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.export.csv_file import read_table
from neuroanimator.gym.gaits import GaitClip, GaitEntries, on_command
from neuroanimator.physics.rigid.joints import JointView
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.layout import Layout
from neuroanimator.state.rotation import facing, heading_of, multiply, rotate
from neuroanimator.systems.system import System

RATE_TOLERANCE = 1e-3
"""Tolerance of the time between rows, as a share of a control's."""

UNIT_TOLERANCE = 1e-3
"""Tolerance of the length of a quaternion."""

CLOCK_TOLERANCE = 1e-3
"""Tolerance of the clock, as a share of its step."""

SEAM = 0.05
"""Largest difference of an angle between the first and the last pose of a repeated motion [rad]."""

FREE = "free"


def read_motion(path: Path, table: FollowTable, system: System) -> ReferenceMotion:
    """Return the motion in the CSV file at `path`, its laps one after another.

    ArgumentError for a body that no motion can drive, BadFileError for a motion of another body, at another rate, or
    with invalid numbers: each names the remedy.
    """
    body = _servoed(system)
    if body.views[0].kind != FREE:
        raise ArgumentError("follow: wanted a body whose first joint is free.")
    clock = _hinge(body, table.phase, "phase")
    heading = None
    if table.commands is not None:
        heading = _hinge(body, table.commands.heading, "commands.heading")
        if heading == clock:
            raise ArgumentError("follow.commands.heading: it is the clock. Name another hinge.")
    dt = table.hold * system.physics_dt
    jointed = [view for view in body.views[1:] if view not in (clock, heading)]
    hinges = tuple(view.position_entry for view in jointed)
    clip = _read_clip(path, table, body, clock, heading, hinges)
    rates = tuple(view.velocity_entry for view in jointed)
    servos = [body.views[joint] for joint in body.model.actuator_trnid[:, 0]]
    velocity = body.views[0].velocity_entry
    commands = None
    if table.commands is not None and heading is not None:
        run = None
        if table.commands.faster is not None:
            faster = path.parent / table.commands.faster
            run = _read_clip(faster, table, body, clock, heading, hinges)
        entries = GaitEntries(clock, heading, velocity, hinges)
        laps, commands = on_command(body, clip, run, table.commands, table.feet, entries, dt)
    else:
        laps = _laid_out(clip.states, table.laps, clock.position_entry, velocity)
    if len(laps) > MAX_FRAMES:
        raise ArgumentError(
            f"follow.laps: {len(laps):,} states in all; wanted at most {MAX_FRAMES:,}. Repeat the motion less often."
        )
    return ReferenceMotion(
        frames=jnp.asarray(laps, jnp.float32),
        lap=len(clip.states) - 1,
        phase=clock.position_entry,
        velocity=velocity,
        hinges=hinges,
        rates=rates,
        driven=tuple(view.position_entry for view in servos),
        driven_rates=tuple(view.velocity_entry for view in servos),
        leads=_leads(body.model),
        reach=table.reach,
        commands=commands,
    )


def _read_clip(
    path: Path,
    table: FollowTable,
    body: MujocoSystem,
    clock: JointView,
    heading: JointView | None,
    hinges: tuple[int, ...],
) -> GaitClip:
    """Return a clip, the clock's rate constant and a commanded heading zero; BadFileError for one of another body."""
    layout = body.state
    if heading is not None:
        layout = _without(layout, heading)
    times, states = read_table(path, layout)
    if heading is not None:
        states = np.insert(states, heading.position_entry, 0.0, axis=1)
        states = np.insert(states, heading.velocity_entry, 0.0, axis=1)
    dt = table.hold * body.physics_dt
    _check_rate(path, times, dt, table.hold)
    _check_quaternions(path, states)
    _check_clock(path, states[:, clock.position_entry], table.phase)
    states[:, clock.velocity_entry] = TURN / (dt * (len(states) - 1))
    if table.laps > 1 or heading is not None:
        _check_seam(path, states, hinges, body.state)
    return GaitClip(path, states)


def _hinge(body: MujocoSystem, name: str, label: str) -> JointView:
    """Return the hinge called `name`; ArgumentError, which names the key `label`, if it is not one."""
    hinges = [view for view in body.views if view.kind == "hinge"]
    for view in hinges:
        if view.name == name:
            return view
    valid = ", ".join(view.name for view in hinges)
    raise ArgumentError(f"follow.{label}: no hinge called '{name}'. Hinges: {valid}.")


def _without(layout: Layout, joint: JointView) -> Layout:
    """Return the layout of states without a joint's angle and its velocity."""
    entry = 0
    kept = []
    for part in layout.slices:
        if entry not in (joint.position_entry, joint.velocity_entry):
            kept.append(part)
        entry += part.size
    return Layout(tuple(kept))


def _servoed(system: System) -> MujocoSystem:
    """Return the system if all its actuators are angle servos."""
    if not isinstance(system, MujocoSystem):
        raise ArgumentError("follow: wanted a MuJoCo model, whose servos can aim at a motion.")
    model = system.model
    for actuator in range(model.nactuator):
        is_of_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
        stiffness = model.actuator_gainprm[actuator, 0]
        # A servo's force is kp (u − q) − kv q̇.
        is_proportional = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        is_servo = stiffness > 0 and model.actuator_biasprm[actuator, 1] == -stiffness
        if not (is_of_joint and is_proportional and is_servo):
            name = model.actuator(actuator).name
            raise ArgumentError(
                f"follow: actuator '{name}' is no servo of a joint. Write it as <position joint=... kp=.../>, so that it "
                "can aim at the motion's angles."
            )
    return system


def _leads(model: mujoco.MjModel) -> tuple[float, ...]:
    """Return the lag of each servo behind a steady rotation [s]."""
    joints = model.actuator_trnid[:, 0]
    damping = model.dof_damping[model.jnt_dofadr[joints]] - model.actuator_biasprm[:, 2]
    return tuple((damping / model.actuator_gainprm[:, 0]).tolist())


def _check_rate(path: Path, times: Float[np.ndarray, " K"], dt: float, hold: int) -> None:
    if len(times) < 2:
        raise BadFileError(f"{path}: wanted two states or more.")
    gaps = np.diff(times)
    wrong = np.flatnonzero(np.abs(gaps - dt) > RATE_TOLERANCE * dt)
    if len(wrong):
        row = int(wrong[0])
        raise BadFileError(
            f"{path}, line {row + 3}: {gaps[row]:.6g} s after the row before; wanted {dt:g} s, for which a control is held "
            f"(follow.hold = {hold}). Resample the motion, or change follow.hold."
        )


def _check_quaternions(path: Path, states: Float[np.ndarray, "K S"]) -> None:
    lengths = np.linalg.norm(states[:, ORIENTATION], axis=1)
    wrong = np.flatnonzero(np.abs(lengths - 1) > UNIT_TOLERANCE)
    if len(wrong):
        row = int(wrong[0])
        raise BadFileError(
            f"{path}, line {row + 2}: the root's quaternion has length {lengths[row]:.4g}; wanted 1. Divide it by its length."
        )


def _check_clock(path: Path, angles: Float[np.ndarray, " K"], name: str) -> None:
    wanted = np.linspace(0, TURN, len(angles))
    off = np.abs(angles - wanted)
    worst = int(off.argmax())
    if off[worst] > CLOCK_TOLERANCE * wanted[1]:
        raise BadFileError(
            f"{path}, line {worst + 2}: '{name}' is {angles[worst]:.6g}; wanted {wanted[worst]:.6g}, as it turns once in the "
            "motion, evenly from 0 to 2π."
        )


def _check_seam(
    path: Path, states: Float[np.ndarray, "K S"], hinges: tuple[int, ...], layout: Layout
) -> None:
    entries = list(hinges)
    apart = np.abs(states[-1, entries] - states[0, entries])
    worst = int(apart.argmax())
    if apart[worst] > SEAM:
        name = layout.names[entries[worst]]
        raise BadFileError(
            f"{path}: its last pose is not its first: '{name}' differs by {apart[worst]:.2g}. Close the loop, or set "
            "follow.laps = 1."
        )


def _laid_out(
    states: Float[np.ndarray, "K S"], laps: int, clock: int, velocity: int
) -> Float[np.ndarray, "L S"]:
    """Return the states of all laps: each continues from the position and heading at the end of the one before."""
    moving = slice(velocity, velocity + 3)
    lap = states
    parts = [states]
    for _ in range(1, laps):
        first = lap[0]
        last = lap[-1]
        heading = heading_of(last[ORIENTATION]) - heading_of(first[ORIENTATION])
        turned = np.broadcast_to(facing(np.asarray(heading)), (len(lap), 4))
        lap = lap.copy()
        lap[:, POSITION] = rotate(turned, lap[:, POSITION] - first[POSITION])
        lap[:, POSITION] += [last[0], last[1], first[2]]
        lap[:, ORIENTATION] = multiply(turned, lap[:, ORIENTATION])
        lap[:, moving] = rotate(turned, lap[:, moving])
        lap[:, clock] += TURN
        parts.append(lap[1:])
    return np.concatenate(parts)
