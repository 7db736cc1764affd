"""Propose a definition for a MuJoCo model: what can be read off it, and what a few trial runs show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from neuroanimator.data.config import RUN_STEPS
from neuroanimator.definitions.function import PythonDefinition
from neuroanimator.definitions.model import Definition
from neuroanimator.definitions.recorded import RecordedDefinition
from neuroanimator.errors import BadFileError
from neuroanimator.scaffold.actuators import (
    actuator_faults,
    possible_controls,
    proposed_bounds,
    wide_enough,
)
from neuroanimator.scaffold.comments import Findings, comments_on, told_of, warnings_about
from neuroanimator.scaffold.defaults import WANTED_SUPER_STEP, tidy, usual_name
from neuroanimator.scaffold.holding import holding_controls, holding_table
from neuroanimator.scaffold.motion import TILTS, choose_motion, free_spread, system_of
from neuroanimator.scaffold.surroundings import (
    can_touch_ground,
    free_root_is_placed,
    gravity_of,
    has_contacts,
    has_free_root,
    is_placeless,
    planar_root,
)
from neuroanimator.scaffold.teacher import (
    choose_teacher,
)
from neuroanimator.scaffold.trials import (
    Trial,
    growth_at_rest,
)
from neuroanimator.systems.rigid.bones import JOINT_NAMES
from neuroanimator.systems.rigid.compiled_model import compile_model
from neuroanimator.systems.rigid.ground import height_entry
from neuroanimator.systems.rigid.joints import FEATURES, joint_name
from neuroanimator.systems.rigid.model_files import read_model_files
from neuroanimator.systems.rigid.model_system import HOME, ModelSystem, keyframe_name
from neuroanimator.systems.rigid.mujoco_system import INTEGRATORS
from neuroanimator.systems.rigid.symmetries import symmetries_of
from neuroanimator.systems.rigid.touching import is_limited
from neuroanimator.tables import check_table
from neuroanimator.terminal import phase

FINE_PARTS = 10
"""The fine step, which every error is measured against, is the model's step cut into this many."""

WARM_UP = 1.0
"""Time for which models with contacts are driven before a run is recorded [s]: random starts float in the air or overlap."""

RESET_SHARE = 0.2
"""Share of runs that begin at rest or at a keyframe: there motions are begun, and random starts may never be there."""


@dataclass(frozen=True)
class Proposal:
    """A definition, and what is worth telling the user about it."""

    definition: Definition | PythonDefinition | RecordedDefinition
    notes: dict[str, str]
    """Per key of the TOML file, why its value was proposed."""
    parts: list[str]
    """Names of the parts of the state."""
    warnings: tuple[str, ...] = ()
    """What the user should look at before anything is generated."""
    told: tuple[tuple[str, str], ...] = ()
    """What else is told on the screen, as rows: what was added to the model or left out, and what trial runs showed."""


def propose(
    path: Path,
    *,
    keyframe: str = "",
    base: Literal["fixed", "free"] = "fixed",
    passive: tuple[str, ...] = (),
    tree: Path | None = None,
    reset_noise: float = 0.0,
) -> Proposal:
    """Return a definition of the MJCF or URDF model at `path`.

    `keyframe` names the one that is the state of rest; `base` says whether the root of a URDF stands fixed or is free.
    No motor drives its `passive` joints. Some runs begin at rest and at keyframes, with `reset_noise`.
    Includes and meshes may lie in the folder `tree`; without it in the model's own, or in the ROS package it lies in.
    Raises BadFileError for a model that cannot be emulated, saying why; ArgumentError for a keyframe or a passive joint
    that is not there, and if no scheme steps the model without diverging.
    """
    model = compile_model(read_model_files(path, tree), base, passive)
    faults = actuator_faults(path, model)
    if faults:
        raise BadFileError(faults)
    values = _read_off(path, model, keyframe, base)
    values["passive"] = passive
    values["sampling"] |= {"reset_share": RESET_SHARE, "reset_noise": reset_noise}
    system = system_of(values, model)
    low, high = possible_controls(model, system.bounds)
    number = _keyframe_number(model, values["keyframe"])
    hold = holding_controls(model, system.rest[: system.physical_size], low, high, number)
    whole = wide_enough(model, values["control"], hold.controls)
    values["control"] = whole
    growth = growth_at_rest(model, system.rest[: system.physical_size], hold.controls)
    with phase("simulating"):
        motion = choose_motion(values, model, hold, growth)
    values = motion.values
    values["holding"] = holding_table(model, values["control"], hold)
    system = system_of(values, model)
    with phase("looking for symmetries"):
        trial = motion.trial
        states = trial.states[:, :-1].reshape(-1, system.state.size)
        symmetries = symmetries_of(system, states, trial.controls.reshape(len(states), -1))
    values["frame"]["symmetries"] = bool(symmetries)
    teacher = choose_teacher(system, motion.trial, _usual_contacts(system, motion.trial))
    lost = _resets_that_diverge(system, motion.dt)
    values["physics"] |= {
        "truth_step": teacher.scheme.dt,
        "truth_integrator": teacher.scheme.integrator,
        "fine_step": teacher.fine.dt,
        "fine_integrator": teacher.fine.integrator,
    }
    found = Findings(motion, hold, growth, whole, teacher, symmetries, lost)
    definition = check_table(values, path.name, Definition)
    parts = [part.name for part in system.state.slices]
    return Proposal(
        definition,
        comments_on(system, found),
        parts,
        tuple(warnings_about(model, found)),
        told_of(model, found),
    )


def _read_off(path: Path, model: mujoco.MjModel, keyframe: str, base: str) -> dict[str, Any]:
    """Return the definition's table as far as the model itself says it."""
    step = float(model.opt.timestep)
    integrator = _own_integrator(model)
    planar = planar_root(model)
    is_free = has_free_root(model) and not free_root_is_placed(model)
    has_weight = bool(np.any(gravity_of(model)))
    has_ground = can_touch_ground(model)
    features = {}
    widths = {}
    for joint in range(model.njnt):
        name = joint_name(model, joint)
        features[name] = proposed_feature(model, joint, planar)
        width = free_spread(model, joint)
        if features[name] not in ("cyclic", "free", "placed") and width is not None:
            widths[name] = width
    for name in planar[:2]:
        widths.pop(name, None)
    warm_up = 0.0
    if has_contacts(model):
        warm_up = WARM_UP
    tilt = 0.0
    if has_free_root(model):
        tilt = TILTS[0]
    return {
        "name": usual_name(path),
        "model": path.name,
        "base": base,
        "keyframe": keyframe or _usual_keyframe(model),
        "substeps": max(1, round(WANTED_SUPER_STEP / step)),
        "physics": {
            "step": step,
            "integrator": integrator,
            "truth_step": step,
            "truth_integrator": integrator,
            "fine_step": tidy(step / FINE_PARTS),
            "fine_integrator": "rk4",
        },
        "state": features,
        "frame": {
            "ground": is_free and has_weight and has_ground,
            "contacts": has_ground or any(is_limited(model, i) for i in range(model.njnt)),
            "planar": planar,
        },
        "control": proposed_bounds(model),
        "sampling": {
            "warm_up": warm_up,
            "tilt": tilt,
            "above_ground": has_ground and height_entry(model) is not None,
            "position": widths,
        },
    }


def _usual_keyframe(model: mujoco.MjModel) -> str:
    """Return the keyframe that is the state of rest if the user names none: `home`, else the first."""
    names = [keyframe_name(model, i) for i in range(model.nkey)]
    if HOME in names:
        return HOME
    return names[0] if names else ""


def _keyframe_number(model: mujoco.MjModel, name: str) -> int:
    """Return the number of a keyframe, -1 if there is none of this name."""
    names = [keyframe_name(model, i) for i in range(model.nkey)]
    return names.index(name) if name in names else -1


def _own_integrator(model: mujoco.MjModel) -> str:
    """Return our name of the integrator the model asks for."""
    names = {int(value): name for name, value in INTEGRATORS.items()}
    return names[int(model.opt.integrator)]


def proposed_feature(model: mujoco.MjModel, joint: int, planar: tuple[str, ...]) -> str:
    """Return how a joint should be represented to the network; `planar` are the joints of a planar root."""
    kind = JOINT_NAMES[int(model.jnt_type[joint])]
    if joint_name(model, joint) in planar:
        return "planar"
    if kind == "free" and (joint > 0 or free_root_is_placed(model)):
        return "placed"
    if kind == "hinge":
        is_bounded = is_limited(model, joint) and np.ptp(model.jnt_range[joint]) < np.pi
        return "plain" if is_bounded else "sine"
    if kind == "slide" and is_placeless(model, joint):
        return "cyclic"
    return FEATURES[kind][0]


def _usual_contacts(system: ModelSystem, trial: Trial) -> float:
    """Return how many contacts there are on average in trial runs."""
    every = max(1, trial.states.shape[1] // 4)
    states = trial.states[:, ::every].reshape(-1, system.state.size)
    return float(np.mean(system.contact_counts(states)))


def _resets_that_diverge(system: ModelSystem, dt: float) -> list[str]:
    """Return which of rest and keyframes a run cannot begin at: such runs diverge, and are left out of the data."""
    starts = system.with_sensors(system.resets)
    controls = np.broadcast_to(system.bounds.idle, (len(starts), RUN_STEPS, system.control.size))
    runs = system.simulate_fastest(starts, controls, dt)
    names = ["rest"]
    names += [f"keyframe {keyframe_name(system.model, i)}" for i in range(system.model.nkey)]
    return [name for name, lost in zip(names, runs.has_diverged, strict=True) if lost]
