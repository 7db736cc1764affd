"""A first definition for somebody's MuJoCo model: what can be read off it, and what a few trial runs show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.scaffold.defaults import GOOD_ENOUGH, WHOLE_TURN, proposed_substeps
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

TRIAL_RUNS, TRIAL_SECONDS = 16, 2.0
TRIAL_SEED = 0

UNLIMITED_CONTROL = (-1.0, 1.0)


@dataclass(frozen=True)
class Proposal:
    """A definition, and what is worth telling the user about it."""

    definition: Definition | PythonDefinition | RecordedDefinition
    notes: dict[str, str]
    """Per key of the TOML file, why its value was proposed."""
    parts: list[str]
    """Names of the parts of the state."""


def propose(path: Path) -> Proposal:
    """Return a definition of the MJCF or URDF model at `path`; refuse what cannot be emulated, by name."""
    model = compile_model(read_model_files(path))
    if not model.nu:
        how = "Add an <actuator> section: something must drive the model."
        if path.suffix.lower() == ".urdf":
            how = "A URDF cannot have any: let MuJoCo save it as MJCF (mujoco.mj_saveLastXML), add an <actuator> section."
        raise BadFileError(f"{path.name} has no actuators. {how}")
    values = _read_off(path, model)
    notes = {"physics.step": "the model's own [s]", "physics.integrator": "the model's own"}
    sensors = [name for i in range(model.nsensor) if (name := sensor_name(model, i))]
    notes["sensors"] = f"those to be emulated too, of: {', '.join(sensors) or 'none'}"
    notes |= {
        f"control.{name}": "the model gives no range: say what your motor can do"
        for name, unlimited in zip(values["control"], _unlimited(model), strict=True)
        if unlimited
    }
    system = ModelSystem(check_table(values, path.name, Definition), model)
    with phase("simulating"):
        values["sampling"]["velocity"] = _usual_speeds(system, path)
    system = ModelSystem(check_table(values, path.name, Definition), model)
    scheme, error, own = _teacher(system)
    values["physics"] |= {"truth_step": scheme.dt, "truth_integrator": scheme.integrator}
    notes["physics.truth_step"] = (
        f"teaches with an error of {error:.2g} of a super step's change; the model's own: {own:.2g}"
    )
    return Proposal(
        check_table(values, path.name, Definition),
        notes,
        [part.name for part in system.state.slices],
    )


def _read_off(path: Path, model: mujoco.MjModel) -> dict[str, Any]:
    """Return what the model itself says."""
    step = float(model.opt.timestep)
    integrator = next(
        name for name, value in INTEGRATORS.items() if int(value) == int(model.opt.integrator)
    )
    planar, has_free = planar_root(model), model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    ground = bool(has_free and np.any(model.opt.gravity) and _can_touch_ground(model))
    names = [actuator_name(model, i) for i in range(model.nu)]
    return {
        "name": path.stem.lower().replace(" ", "-"),
        "model": path.name,
        "substeps": proposed_substeps(step),
        "physics": {
            "step": step,
            "integrator": integrator,
            "truth_step": step / 2,
            "truth_integrator": integrator,
            "fine_step": step / 10,
            "fine_integrator": "rk4",
        },
        "state": {joint_name(model, j): look(model, j, planar) for j in range(model.njnt)},
        "frame": {"ground": ground, "planar": planar},
        "control": {
            name: control_range(model, i) or UNLIMITED_CONTROL for i, name in enumerate(names)
        },
        "sampling": {
            "warm_up": 1.0 if has_contacts(model) else 0.0,
            "tilt": 0.1 if has_free else 0.0,
            "position": {
                joint_name(model, j): width
                for j in range(model.njnt)
                if (width := _width(model, j))
            },
        },
    }


def planar_root(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the joints x, y, heading of a root that moves freely in a level plane, or nothing."""
    joints = [j for j in range(model.njnt) if model.jnt_bodyid[j] == model.jnt_bodyid[0]][:3]
    kinds = [JOINT_NAMES[int(model.jnt_type[j])] for j in joints]
    if kinds != ["slide", "slide", "hinge"] or any(model.jnt_limited[j] for j in joints):
        return ()
    x, y, axis = (model.jnt_axis[j] for j in joints)
    is_level = np.linalg.norm(np.cross(model.opt.gravity, axis)) < 1e-9
    is_plane = np.allclose(np.cross(x, y), axis) and abs(x @ y) < 1e-9
    hangs_free = not has_contacts(model) and model.body_parentid[model.jnt_bodyid[0]] == 0
    return (
        tuple(joint_name(model, j) for j in joints) if is_level and is_plane and hangs_free else ()
    )


def look(model: mujoco.MjModel, joint: int, planar: tuple[str, ...]) -> str:
    """Return how the network should see a joint."""
    kind, name = JOINT_NAMES[int(model.jnt_type[joint])], joint_name(model, joint)
    if name in planar:
        return "planar"
    if kind == "hinge":
        return (
            "plain"
            if model.jnt_limited[joint] and np.ptp(model.jnt_range[joint]) < np.pi
            else "sine"
        )
    is_level = abs(model.jnt_axis[joint] @ model.opt.gravity) < 1e-9
    is_root = model.body_parentid[model.jnt_bodyid[joint]] == 0
    if (
        kind == "slide"
        and is_root
        and is_level
        and not model.jnt_limited[joint]
        and not model.jnt_stiffness[joint]
    ):
        return "cyclic"
    return FEATURES[kind][0]


def _width(model: mujoco.MjModel, joint: int) -> float:
    """Return half the width of a joint's random starts: its range, a whole turn, or none if place does not matter."""
    kind = JOINT_NAMES[int(model.jnt_type[joint])]
    if kind in ("free", "ball"):
        return 0.3 if kind == "ball" else 0.0
    if model.jnt_limited[joint]:
        low, high = model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]
        return round(float(max(0.0, min(-low, high))), 4)
    return WHOLE_TURN if kind == "hinge" else 0.0


def has_contacts(model: mujoco.MjModel) -> bool:
    """Return whether anything can touch anything."""
    masks = (model.geom_contype[:, None] & model.geom_conaffinity[None]) | (
        model.geom_contype[None] & model.geom_conaffinity[:, None]
    )
    apart = model.geom_bodyid[:, None] != model.geom_bodyid[None]
    is_off = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    return bool(not is_off and (model.npair or (masks * apart).any()))


def _can_touch_ground(model: mujoco.MjModel) -> bool:
    return has_contacts(model) and bool((model.geom_bodyid == 0).any())


def _unlimited(model: mujoco.MjModel) -> list[bool]:
    return [control_range(model, actuator) is None for actuator in range(model.nu)]


def _trial(system: ModelSystem) -> tuple[np.ndarray, np.ndarray, float]:
    """Return (states (B, T+1, S), controls, super step) of trial runs under random controls that jump at every step."""
    rng = np.random.default_rng(TRIAL_SEED)
    dt = proposed_substeps(system.physics_dt) * system.physics_dt
    starts = system.sample_starts(rng, TRIAL_RUNS)
    shape = (TRIAL_RUNS, round(TRIAL_SECONDS / dt), system.control.size)
    controls = system.bounds.middle + rng.uniform(-1, 1, shape) * system.bounds.half
    runs = system.simulate(starts, controls, dt, scheme=system.scheme)
    return runs.states[~runs.has_diverged], controls[~runs.has_diverged], dt


def _usual_speeds(system: ModelSystem, path: Path) -> dict[str, tuple[float, ...]]:
    """Return per joint the rms of its speeds in trial runs: random starts should be as fast as use is."""
    states, _, _ = _trial(system)
    if len(states) < TRIAL_RUNS / 2:
        raise BadFileError(
            f"{path.name}: {TRIAL_RUNS - len(states)} of {TRIAL_RUNS} trial runs under random controls diverged at the "
            f"model's own step of {system.physics_dt:g} s. Use a smaller timestep, or weaker actuators."
        )
    velocities = {}
    for view in system.views:
        size = {"free": 6, "ball": 3}.get(view.kind, 1)
        rms = np.sqrt(np.mean(states[..., view.rate : view.rate + size] ** 2, axis=(0, 1)))
        velocities[view.name] = tuple(float(f"{value:.2g}") for value in rms)
    return velocities


def _teacher(system: ModelSystem) -> tuple[Scheme, float, float]:
    """Return (the cheapest scheme good enough to teach, its error, the model's own error) by trial."""
    states, controls, dt = _trial(system)
    starts, held = (
        states[:, :-1].reshape(-1, system.state.size),
        controls.reshape(-1, 1, system.control.size),
    )
    with phase("simulating finely"):
        exact = system.simulate(starts, held, dt, scheme=system.fine)
    frame = Frame.of(system.structure, dt)
    unit = np.maximum(frame.difference(starts, exact.states[:, 1]).std(axis=0), 1e-9)

    def error(scheme: Scheme) -> float:
        runs = system.simulate(starts, held, dt, scheme=scheme)
        if runs.has_diverged.any():
            return float("inf")
        return float(
            np.sqrt(np.mean((frame.difference(exact.states[:, 1], runs.states[:, 1]) / unit) ** 2))
        )

    step, own = system.physics_dt, error(system.scheme)
    ways = [Scheme("rk4", step), system.scheme, Scheme("rk4", step / 2), Scheme("rk4", step / 5)]
    ways += [Scheme(system.scheme.integrator, step / parts) for parts in (2, 5)]
    errors = []
    with progress_bar("physics steps tried", len(ways)) as bar:
        for way in ways:
            errors.append(error(way))
            bar.advance_to(len(errors), f"{way.integrator} {way.dt * 1e3:.3g} ms")
    for way, found in zip(ways, errors, strict=True):
        if found <= GOOD_ENOUGH:
            return way, found, own
    best = int(np.argmin(errors))
    if not np.isfinite(errors[best]):
        raise ArgumentError(
            "No scheme steps this model without diverging. Use a smaller timestep in the model."
        )
    return ways[best], errors[best], own
