"""Propose a definition for a MuJoCo model: what can be read off it, and what a few trial runs show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.scaffold.defaults import ANGLE_SPREAD, MAX_TEACHER_ERROR, proposed_substeps
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.rigid.actuators import actuator_name, control_range
from neuroanimator.systems.rigid.bones import JOINT_NAMES
from neuroanimator.systems.rigid.joints import FEATURES, joint_name, sensor_name
from neuroanimator.systems.rigid.model_files import compile_model, read_model_files
from neuroanimator.systems.rigid.model_system import ModelSystem
from neuroanimator.systems.rigid.mujoco_system import INTEGRATORS
from neuroanimator.systems.system import Scheme
from neuroanimator.tables import check_table
from neuroanimator.terminal import phase, progress_bar

TRIAL_RUNS = 16
"""This many trial runs show how fast the joints move; each starts elsewhere."""

TRIAL_SECONDS = 2.0
"""A trial run is about this long [s]: long enough for random controls to set a model moving."""

TRIAL_SEED = 0
"""Trial runs are drawn with this seed, so that a proposal is the same every time."""

UNLIMITED_CONTROL = (-1.0, 1.0)
"""An actuator without a range is proposed this one (least, largest), with a note to correct it."""

FINE_PARTS = 10
"""The fine step, which every error is measured against, is the model's step cut into this many."""

MIN_CHANGE = 1e-9
"""An entry that changes less than this in a super step does not count by more than its difference over this."""

LEVEL_TOLERANCE = 1e-9
"""An axis is level, or at right angles to another, if their product is below this: rounding only."""

WARM_UP = 1.0
"""A model with contacts is driven for this long [s] before a run is recorded, so that contacts have settled."""

ROOT_TILT = 0.1
"""A free root is proposed to start tilted with this standard deviation [rad]."""

BALL_SPREAD = 0.3
"""A ball joint is proposed to start turned with this standard deviation [rad]."""

VELOCITY_SIZES = {"free": 6, "ball": 3, "slide": 1, "hinge": 1}
"""A joint of each kind has this many velocities."""


@dataclass(frozen=True)
class Proposal:
    """A definition, and what is worth telling the user about it."""

    definition: Definition | PythonDefinition | RecordedDefinition
    notes: dict[str, str]
    """Per key of the TOML file, why its value was proposed."""
    parts: list[str]
    """Names of the parts of the state."""


class Trial(NamedTuple):
    """Trial runs under random controls that jump at every super step; diverged ones are left out."""

    states: Float[np.ndarray, "B T+1 S"]
    """The start, and the state after each control."""
    controls: Float[np.ndarray, "B T C"]
    """Row k is held from state k to state k+1."""
    dt: float
    """Time one super step covers [s]."""


class Teacher(NamedTuple):
    """The scheme that shall teach, and what it costs in accuracy."""

    scheme: Scheme
    """The first of those tried that is good enough, else the best of them."""
    error: float
    """Its one-step error, as a share of the standard deviation of a super step's change."""
    own_error: float
    """The same of the scheme the model asks for."""


def propose(path: Path) -> Proposal:
    """Return a definition of the MJCF or URDF model at `path`.

    Raises BadFileError for a model that cannot be emulated, saying why; ArgumentError if no scheme
    steps it without diverging.
    """
    model = compile_model(read_model_files(path))
    if not model.nu:
        how = "Add an <actuator> section: something must drive the model."
        if path.suffix.lower() == ".urdf":
            how = "A URDF cannot have any: let MuJoCo save it as MJCF (mujoco.mj_saveLastXML), add an <actuator> section."
        raise BadFileError(f"{path.name} has no actuators. {how}")
    values = _read_off(path, model)
    notes = _notes(model)
    system = ModelSystem(check_table(values, path.name, Definition), model)
    with phase("simulating"):
        values["sampling"]["velocity"] = _usual_velocities(system, path)
    system = ModelSystem(check_table(values, path.name, Definition), model)
    teacher = _teacher(system)
    values["physics"]["truth_step"] = teacher.scheme.dt
    values["physics"]["truth_integrator"] = teacher.scheme.integrator
    notes["physics.truth_step"] = (
        f"teaches with an error of {teacher.error:.2g} of a super step's change; the model's own: {teacher.own_error:.2g}"
    )
    definition = check_table(values, path.name, Definition)
    parts = [part.name for part in system.state.slices]
    return Proposal(definition, notes, parts)


def _notes(model: mujoco.MjModel) -> dict[str, str]:
    """Return the notes that need no trial, by key of the TOML file."""
    names = [sensor_name(model, sensor) for sensor in range(model.nsensor)]
    sensors = ", ".join(name for name in names if name)
    notes = {
        "physics.step": "the model's own [s]",
        "physics.integrator": "the model's own",
        "sensors": f"those to be emulated too, of: {sensors or 'none'}",
    }
    for actuator in range(model.nu):
        if control_range(model, actuator) is None:
            key = f"control.{actuator_name(model, actuator)}"
            notes[key] = "the model gives no range: say what your motor can do"
    return notes


def _read_off(path: Path, model: mujoco.MjModel) -> dict[str, Any]:
    """Return the definition's table as far as the model itself says it."""
    step = float(model.opt.timestep)
    integrator = _own_integrator(model)
    planar = planar_root(model)
    has_free_root = bool(model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE)
    has_weight = bool(np.any(model.opt.gravity))
    features = {}
    widths = {}
    for joint in range(model.njnt):
        name = joint_name(model, joint)
        features[name] = proposed_feature(model, joint, planar)
        width = _start_width(model, joint)
        if width:
            widths[name] = width
    controls = {}
    for actuator in range(model.nu):
        bounds = control_range(model, actuator) or UNLIMITED_CONTROL
        controls[actuator_name(model, actuator)] = bounds
    warm_up = 0.0
    if has_contacts(model):
        warm_up = WARM_UP
    tilt = 0.0
    if has_free_root:
        tilt = ROOT_TILT
    return {
        "name": path.stem.lower().replace(" ", "-"),
        "model": path.name,
        "substeps": proposed_substeps(step),
        "physics": {
            "step": step,
            "integrator": integrator,
            "truth_step": step / 2,
            "truth_integrator": integrator,
            "fine_step": step / FINE_PARTS,
            "fine_integrator": "rk4",
        },
        "state": features,
        "frame": {
            "ground": has_free_root and has_weight and _can_touch_ground(model),
            "planar": planar,
        },
        "control": controls,
        "sampling": {"warm_up": warm_up, "tilt": tilt, "position": widths},
    }


def _own_integrator(model: mujoco.MjModel) -> str:
    """Return our name of the integrator the model asks for."""
    names = {int(value): name for name, value in INTEGRATORS.items()}
    return names[int(model.opt.integrator)]


def planar_root(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the joints x, y, heading of a root that moves freely in a level plane, or nothing."""
    root = model.jnt_bodyid[0]
    joints = [joint for joint in range(model.njnt) if model.jnt_bodyid[joint] == root][:3]
    kinds = [JOINT_NAMES[int(model.jnt_type[joint])] for joint in joints]
    if kinds != ["slide", "slide", "hinge"]:
        return ()
    if any(model.jnt_limited[joint] for joint in joints):
        return ()
    x, y, axis = model.jnt_axis[joints]
    is_level = np.linalg.norm(np.cross(model.opt.gravity, axis)) < LEVEL_TOLERANCE
    is_plane = np.allclose(np.cross(x, y), axis) and abs(x @ y) < LEVEL_TOLERANCE
    hangs_free = not has_contacts(model) and model.body_parentid[root] == 0
    if not (is_level and is_plane and hangs_free):
        return ()
    return tuple(joint_name(model, joint) for joint in joints)


def proposed_feature(model: mujoco.MjModel, joint: int, planar: tuple[str, ...]) -> str:
    """Return how a joint should be represented to the network; `planar` are the joints of a planar root."""
    kind = JOINT_NAMES[int(model.jnt_type[joint])]
    is_limited = model.jnt_limited[joint]
    if joint_name(model, joint) in planar:
        return "planar"
    if kind == "hinge":
        is_less_than_half_turn = is_limited and np.ptp(model.jnt_range[joint]) < np.pi
        return "plain" if is_less_than_half_turn else "sine"
    is_level = abs(model.jnt_axis[joint] @ model.opt.gravity) < LEVEL_TOLERANCE
    is_root = model.body_parentid[model.jnt_bodyid[joint]] == 0
    is_unbound = not is_limited and not model.jnt_stiffness[joint]
    if kind == "slide" and is_root and is_level and is_unbound:
        return "cyclic"
    return FEATURES[kind][0]


def _start_width(model: mujoco.MjModel, joint: int) -> float:
    """Return the spread of a joint's random starts, as `Sampling.position` says [rad or m].

    It is the joint's range, a whole turn, or zero where the position does not matter.
    """
    kind = JOINT_NAMES[int(model.jnt_type[joint])]
    if kind == "free":
        return 0.0
    if kind == "ball":
        return BALL_SPREAD
    if model.jnt_limited[joint]:
        low, high = model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]
        return round(float(max(0.0, min(-low, high))), 4)
    if kind == "hinge":
        return ANGLE_SPREAD
    return 0.0


def has_contacts(model: mujoco.MjModel) -> bool:
    """Return whether anything can touch anything."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        return False
    if model.npair:
        return True
    # Two geoms collide if the type of one matches the affinity of the other (MuJoCo, "Collision detection").
    matches = model.geom_contype[:, None] & model.geom_conaffinity[None]
    can_collide = matches | matches.T
    is_other_body = model.geom_bodyid[:, None] != model.geom_bodyid[None]
    return bool((can_collide * is_other_body).any())


def _can_touch_ground(model: mujoco.MjModel) -> bool:
    return has_contacts(model) and bool((model.geom_bodyid == 0).any())


def _trial(system: ModelSystem) -> Trial:
    """Return trial runs by the model's own scheme."""
    rng = np.random.default_rng(TRIAL_SEED)
    dt = proposed_substeps(system.physics_dt) * system.physics_dt
    starts = system.sample_starts(rng, TRIAL_RUNS)
    shape = (TRIAL_RUNS, round(TRIAL_SECONDS / dt), system.control.size)
    controls = system.bounds.middle + rng.uniform(-1, 1, shape) * system.bounds.half
    runs = system.simulate(starts, controls, dt, scheme=system.scheme)
    is_whole = ~runs.has_diverged
    return Trial(runs.states[is_whole], controls[is_whole], dt)


def _usual_velocities(system: ModelSystem, path: Path) -> dict[str, tuple[float, ...]]:
    """Return per joint the rms of its velocities in trial runs: random starts should be as fast as use is."""
    states = _trial(system).states
    if len(states) < TRIAL_RUNS / 2:
        raise BadFileError(
            f"{path.name}: {TRIAL_RUNS - len(states)} of {TRIAL_RUNS} trial runs under random controls diverged at the "
            f"model's own step of {system.physics_dt:g} s. Use a smaller timestep, or weaker actuators."
        )
    velocities = {}
    for view in system.views:
        size = VELOCITY_SIZES[view.kind]
        joint_velocities = states[..., view.velocity_entry : view.velocity_entry + size]
        rms = np.sqrt(np.mean(joint_velocities**2, axis=(0, 1)))
        velocities[view.name] = tuple(float(f"{value:.2g}") for value in rms)
    return velocities


def _teacher(system: ModelSystem) -> Teacher:
    """Return the cheapest scheme that is good enough to teach, by trial.

    Raises ArgumentError if every scheme diverges.
    """
    trial = _trial(system)
    starts = trial.states[:, :-1].reshape(-1, system.state.size)
    controls = trial.controls.reshape(-1, 1, system.control.size)
    with phase("simulating finely"):
        exact = system.simulate(starts, controls, trial.dt, scheme=system.fine).states[:, 1]
    frame = Frame.of(system.structure, trial.dt)
    unit = np.maximum(frame.difference(starts, exact).std(axis=0), MIN_CHANGE)

    def error_of(scheme: Scheme) -> float:
        runs = system.simulate(starts, controls, trial.dt, scheme=scheme)
        if runs.has_diverged.any():
            return float("inf")
        differences = frame.difference(exact, runs.states[:, 1]) / unit
        return float(np.sqrt(np.mean(differences**2)))

    own_error = error_of(system.scheme)
    schemes = _schemes_to_try(system)
    errors = []
    with progress_bar("physics steps tried", len(schemes)) as bar:
        for scheme in schemes:
            errors.append(error_of(scheme))
            bar.advance_to(len(errors), f"{scheme.integrator} {scheme.dt * 1e3:.3g} ms")
    for scheme, error in zip(schemes, errors, strict=True):
        if error <= MAX_TEACHER_ERROR:
            return Teacher(scheme, error, own_error)
    best = int(np.argmin(errors))
    if not np.isfinite(errors[best]):
        raise ArgumentError(
            "No scheme steps this model without diverging. Use a smaller timestep in the model."
        )
    return Teacher(schemes[best], errors[best], own_error)


def _schemes_to_try(system: ModelSystem) -> list[Scheme]:
    """Return the schemes that may teach, about the cheapest first."""
    step = system.physics_dt
    own = system.scheme
    return [
        Scheme("rk4", step),
        own,
        Scheme("rk4", step / 2),
        Scheme("rk4", step / 5),
        Scheme(own.integrator, step / 2),
        Scheme(own.integrator, step / 5),
    ]
