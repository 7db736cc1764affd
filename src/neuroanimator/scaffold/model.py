"""Proposal for a MuJoCo model, from the model itself and a few trial runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.model import Definition
from neuroanimator.errors import BadFileError
from neuroanimator.files.tables import check_table
from neuroanimator.learn.data.config import RUN_STEPS
from neuroanimator.physics.rigid.bones import joint_kind
from neuroanimator.physics.rigid.compiled_model import compile_model
from neuroanimator.physics.rigid.ground import height_entry
from neuroanimator.physics.rigid.joints import FEATURES, joint_name
from neuroanimator.physics.rigid.mesh_inertia import mesh_warnings
from neuroanimator.physics.rigid.model_system import HOME, ModelSystem, keyframe_name
from neuroanimator.physics.rigid.mujoco_system import INTEGRATORS
from neuroanimator.physics.rigid.symmetries import symmetries_of
from neuroanimator.physics.rigid.touching import is_limited
from neuroanimator.physics.rigid.warnings import forget_other_than, warnings_heard
from neuroanimator.scaffold.actuators import actuator_faults, proposed_bounds, widen_guesses
from neuroanimator.scaffold.comments import TrialFindings, comments_on, told_of, warnings_about
from neuroanimator.scaffold.defaults import FINE_PARTS, proposed_substeps, rounded, usual_name
from neuroanimator.scaffold.flex import propose_flex
from neuroanimator.scaffold.holding import growth_at_rest, holding_controls, holding_table
from neuroanimator.scaffold.motion import TILTS, choose_motion, free_spread, system_of
from neuroanimator.scaffold.proposal import Proposal
from neuroanimator.scaffold.root_invariance import (
    can_touch_ground,
    gravity_of,
    has_contacts,
    has_free_root,
    is_placeless,
    planar_root,
    why_root_is_placed,
)
from neuroanimator.scaffold.teacher import choose_teacher
from neuroanimator.systems.model_files import read_model_files
from neuroanimator.systems.model_xml import refuse
from neuroanimator.terminal import phase
from neuroanimator.text import listed

WARM_UP = 1.0
"""Time for which models with contacts are driven before recording [s]: random starts float in the air or overlap."""

RESET_SHARE = 0.2
"""Share of runs that begin at rest or at a keyframe: motions begin there, and random starts may never be near."""


def propose(
    path: Path,
    *,
    keyframe: str = "",
    base: Literal["fixed", "free"] = "fixed",
    passive: tuple[str, ...] = (),
    tree: Path | None = None,
    reset_noise: float = 0.0,
    resets: Float[np.ndarray, "B S"] | None = None,
) -> Proposal:
    """Return a definition of the MJCF or URDF model at `path`; one with a soft body is `propose_flex`'s.

    `keyframe` names the state of rest; `base` says whether the root of a URDF is fixed or free. No motor drives its
    `passive` joints. Some runs begin at rest and at keyframes, with `reset_noise`; random starts cover the positions and
    velocities of `resets`. Includes and meshes may lie in the folder `tree`; without it, in the model's own, or in its ROS
    package. Raises BadFileError with the reason for a model that cannot be emulated; ArgumentError for a missing keyframe or
    passive joint, and if every scheme diverges.
    """
    files = read_model_files(path, tree)
    model = compile_model(files, base, passive)
    if model.nflex:
        has_options = bool(keyframe or base != "fixed" or passive)
        return propose_flex(path, model, has_options=has_options)
    faults = actuator_faults(path, model)
    if faults:
        raise BadFileError(faults)
    keyframes = [keyframe_name(model, number) for number in range(model.nkey)]
    if not keyframe and keyframes:
        keyframe = HOME if HOME in keyframes else keyframes[0]
    bounds = proposed_bounds(model)
    values: dict[str, Any] = {
        "name": usual_name(path),
        "model": path.name,
        "base": base,
        "passive": passive,
        "keyframe": keyframe,
        "substeps": proposed_substeps(float(model.opt.timestep)),
        "physics": _physics(path.name, model),
        "control": bounds,
        "sampling": {"reset_share": RESET_SHARE, "reset_noise": reset_noise},
    }
    _read_structure(values, model)
    before = warnings_heard()
    system = system_of(values, model)
    hold = holding_controls(system, keyframes.index(keyframe) if keyframe else -1)
    widen_guesses(model, bounds, hold.controls)
    growth = growth_at_rest(system, hold.controls)
    with phase("simulating"):
        motion = choose_motion(values, model, hold, growth, resets)
    values = motion.values
    values["holding"] = holding_table(values["control"], hold)
    system = system_of(values, model)
    trial = motion.trial
    with phase("looking for symmetries"):
        states = trial.states[:, :-1].reshape(-1, system.state.size)
        symmetries = symmetries_of(system, states, trial.controls.reshape(len(states), -1))
    values["frame"]["symmetries"] = bool(symmetries)
    teacher = choose_teacher(system, trial)
    values["physics"] |= {
        "truth_step": teacher.scheme.dt,
        "truth_integrator": teacher.scheme.integrator,
        "fine_step": teacher.fine.dt,
        "fine_integrator": teacher.fine.integrator,
    }
    forget_other_than(before + trial.warnings)
    lost = _resets_that_diverge(system, trial.dt)
    found = TrialFindings(motion, hold, growth, bounds, teacher, lost)
    return Proposal(
        check_table(values, path.name, Definition),
        comments_on(system, found),
        tuple(part.name for part in system.state.slices),
        (*mesh_warnings(files, model), *warnings_about(system, found)),
        told_of(model, found),
        teacher.seconds,
    )


def _physics(file: str, model: mujoco.MjModel) -> dict[str, Any]:
    """Return the model's own step and integrator, which also teach until better ones are known."""
    names = {int(value): name for name, value in INTEGRATORS.items()}
    step = float(model.opt.timestep)
    own = names.get(model.opt.integrator)
    if own is None:
        known = f"this version knows {listed(INTEGRATORS)}. Write one of them"
        refuse(file, f"option integrator (MuJoCo's number {model.opt.integrator})", known)
    return {
        "step": step,
        "integrator": own,
        "truth_step": step,
        "truth_integrator": own,
        "fine_step": rounded(step / FINE_PARTS, 12),
        "fine_integrator": "rk4",
    }


def _read_structure(values: dict[str, Any], model: mujoco.MjModel) -> None:
    """Fill in the state, the frame and random starts from the model."""
    planar = planar_root(model)
    has_ground = can_touch_ground(model)
    features = {}
    widths = {}
    for joint in range(model.njnt):
        name = joint_name(model, joint)
        features[name] = proposed_feature(model, joint, planar)
        width = free_spread(model, joint)
        is_somewhere = features[name] not in ("cyclic", "free", "placed")
        if is_somewhere and name not in planar[:2] and width is not None:
            widths[name] = width
    has_weight = bool(np.any(gravity_of(model)))
    values["state"] = features
    values["frame"] = {
        "ground": features[joint_name(model, 0)] == "free" and has_weight and has_ground,
        "contacts": has_ground or any(is_limited(model, i) for i in range(model.njnt)),
        "planar": planar,
    }
    values["sampling"] |= {
        "warm_up": WARM_UP if has_contacts(model) else 0.0,
        "tilt": TILTS[0] if has_free_root(model) else 0.0,
        "above_ground": has_ground and height_entry(model) is not None,
        "position": widths,
    }


def proposed_feature(model: mujoco.MjModel, joint: int, planar: tuple[str, ...]) -> str:
    """Return the proposed feature of a joint for the network; `planar` are the joints of a planar root."""
    kind = joint_kind(model, joint)
    if joint_name(model, joint) in planar:
        return "planar"
    if kind == "free" and (joint > 0 or why_root_is_placed(model)):
        return "placed"
    if kind == "hinge":
        is_bounded = is_limited(model, joint) and np.ptp(model.jnt_range[joint]) < np.pi
        return "plain" if is_bounded else "sine"
    if kind == "slide" and is_placeless(model, joint):
        return "cyclic"
    return FEATURES[kind][0]


def _resets_that_diverge(system: ModelSystem, dt: float) -> list[str]:
    """Return the names of rest and keyframes from which runs diverge: such runs are left out of the data."""
    starts, _ = system.closed(system.resets)
    controls = np.broadcast_to(system.bounds.idle, (len(starts), RUN_STEPS, system.control.size))
    runs = system.simulate_fastest(starts, controls, dt)
    keyframes = range(system.model.nkey)
    names = ["rest", *(f"keyframe {keyframe_name(system.model, i)}" for i in keyframes)]
    return [name for name, lost in zip(names, runs.has_diverged, strict=True) if lost]
