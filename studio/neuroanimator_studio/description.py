"""What the page needs to know of an emulator, as JSON: names and units, how it is drawn, its goals, what steers it."""

from __future__ import annotations

import base64
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float

import neuroanimator
from neuroanimator import Emulator, Policy, System, is_reached, read_pose
from neuroanimator.authoring import (
    SHIPPED_SYSTEMS,
    EmulatorSpec,
    MujocoSystem,
    Skeleton,
    SoftSystem,
    colours_of,
    definition_of,
    describe_root,
    parts_of,
    skin_mesh,
    stored_latent_size,
)
from neuroanimator.control import Goal, goal_start, goal_state
from neuroanimator.control.policies import StatePolicy

DIGITS = 9
"""Digits of the numbers of a motion: those of float32."""

REACH_DECIMALS = 3
"""Number of decimals of how far a skin reaches from a bone [m]: by it a camera finds the body."""

TARGET = "target"
"""The goal of whatever moves freely and is given none: to be at a place."""

TARGET_SECONDS = 3.0
"""Time in which to get there [s]."""

TARGET_AWAY = (0.77, 0.46, 0.0)
"""Where that place is at first, from where the body is: ahead and to the left, over its length."""

TARGET_WITHIN = 0.25
"""How near counts as there, over the body's length."""

BENEATH = 0.6
"""How deep under the water's surface the middle of a swimmer begins, over its length."""


def describe_emulator(emulator: Emulator, system: System) -> dict[str, Any]:
    """Return what does not hang on motions or files: layouts, bounds, interpolation, appearance, place, goals."""
    facts = _describe(emulator.spec, emulator, system)
    facts["model"] = "emulator"
    facts["title"] = _title(emulator)
    facts["latent"] = stored_latent_size(emulator)
    facts["goals"] = describe_goals(emulator, system)
    if emulator.parameters:
        facts["parameters"] = describe_parameters(emulator)
    facts["verdict"] = describe_verdict(emulator)
    return facts


def describe_parameters(emulator: Emulator) -> list[dict[str, Any]]:
    """Return the name, unit, ends of the range and state entry of each parameter of a family.

    `growth` (N, 3) is by how much mass points at rest lie elsewhere, along the body's own axes, per unit of it; empty where
    states are not of mass points.
    """
    cloud = emulator.state_structure.cloud
    rows = []
    for number, parameter in enumerate(emulator.parameters):
        growth = [] if cloud is None else short_numbers(np.array(cloud.slopes[number]))
        row = {
            "name": parameter.name,
            "unit": parameter.unit,
            "low": parameter.low,
            "high": parameter.high,
            "entry": emulator.parameter_entries[number],
            "growth": growth,
        }
        rows.append(row)
    return rows


def describe_verdict(emulator: Emulator) -> dict[str, str] | None:
    """Return how good an emulator is where it was trained; None where its file does not tell."""
    verdict = emulator.verdict
    if verdict is None:
        return None
    return {"word": verdict.word, "reasons": "; ".join(verdict.reasons)}


def describe_physics(spec: EmulatorSpec, system: System) -> dict[str, Any]:
    """Return the same of a system whose physics the page runs itself; goals are reached through emulators alone."""
    facts = _describe(spec, None, system)
    facts["model"] = "physics"
    facts["title"] = spec.system
    facts["latent"] = spec.state.size
    facts["goals"] = []
    return facts


def _describe(spec: EmulatorSpec, emulator: Emulator | None, system: System) -> dict[str, Any]:
    structure = system.structure if emulator is None else emulator.state_structure
    return {
        "system": spec.system,
        "about": _about(spec),
        "version": neuroanimator.__version__,
        "dt": spec.dt,
        "physics_dt": system.physics_dt,
        "substeps": spec.substeps,
        "can_simulate": system.can_simulate,
        "state": spec.state.to_json(),
        "control": spec.control.to_json(),
        "control_units": control_units(spec, system),
        "control_low": list(spec.bounds.low),
        "control_high": list(spec.bounds.high),
        "rest": list(spec.rest),
        "rates": [list(pair) for pair in spec.rates],
        "orientations": [list(pair) for pair in structure.orientations],
        "skeleton": describe_bones(spec.skeleton),
        "skin": describe_skin(spec.skeleton),
        "surface": describe_surface(spec.skeleton),
        "movers": describe_movers(spec),
        "root": describe_root(structure),
        "size": body_size(spec),
        "scene": describe_scene(spec, system),
        "gait": _gait(spec),
    }


def control_units(spec: EmulatorSpec, system: System) -> list[str]:
    """Return the unit of each number of a control, also of thrusters and tendons; 1 where it is a share, or uncertain.

    An emulator's layout has fewer: it may not change with a release.
    """
    units = []
    for part in spec.control.slices:
        units += [part.unit] * part.size
    if isinstance(system, MujocoSystem) and system.model.nu == len(units):
        for actuator, unit in enumerate(units):
            if unit == "1":
                units[actuator] = _effort_unit(system.model, actuator)
    return units


def _effort_unit(model: Any, actuator: int) -> str:
    """Return N or N·m of an actuator whose control is its force or torque; 1 of any other."""
    import mujoco

    is_direct = model.actuator_gainprm[actuator][0] == 1 and not model.actuator_dyntype[actuator]
    if not is_direct or model.actuator_biasprm[actuator][1]:
        return "1"
    number = model.actuator_trnid[actuator][0]
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_SITE:
        force, torque = np.split(model.actuator_gear[actuator], 2)
        kinds = [(force, "N"), (torque, "N·m")]
        acting = [unit for gear, unit in kinds if np.isclose(np.linalg.norm(gear), 1)]
        return acting[0] if len(acting) == 1 else "1"
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_TENDON:
        first = model.tendon_adr[number]
        wraps = slice(first, first + model.tendon_num[number])
        if (model.wrap_type[wraps] == mujoco.mjtWrap.mjWRAP_JOINT).all():
            joints = model.jnt_type[model.wrap_objid[wraps]]
            if (joints == mujoco.mjtJoint.mjJNT_HINGE).all():
                return "N·m"
    return "1"


def describe_policy(policy: Policy | StatePolicy) -> dict[str, Any]:
    """Return what there is to command, [name, unit, low, high] each, and what the clock gains with a super step [rad].

    The clock and the commands of a state policy are in the state: its `phase_per_step` is None.
    """
    facts = definition_of(policy).facts
    command = []
    ranges = zip(facts["command_low"], facts["command_high"], strict=True)
    for (name, _, unit), (low, high) in zip(facts["command"], ranges, strict=True):
        command.append([name, unit, low, high])
    tick = facts.get("phase_per_step")
    return {"wasm": "policy.wasm", "command": command, "phase_per_step": tick}


def describe_bones(skeleton: Skeleton) -> list[dict[str, Any]]:
    """Return the bones; those that a model's skin follows with the distance [m] that it reaches from them."""
    rows = skeleton.bones_to_json()
    if skeleton.skin is not None and skeleton.skin.kind == "mesh":
        mesh = skin_mesh(skeleton)
        main = mesh.main_bones
        distances = np.linalg.norm(mesh.points - mesh.bind_positions[main], axis=1)
        for number in np.unique(main):
            rows[number]["reach"] = round(float(distances[main == number].max()), REACH_DECIMALS)
    return rows


def describe_skin(skeleton: Skeleton) -> dict[str, Any] | None:
    """Return the triangles of a skin, its colours (sRGB), and what its points follow; that of a model as `MeshSkin` has it.

    Those of deformable bodies are at rest, sorted by part. Each array is base64 of little-endian numbers: float32, and
    uint16 of `bones`, uint32 of `indices`. `uvs` are seen from the side: from nose to tail, and from belly to back.
    """
    skin = skeleton.skin
    if skin is None:
        return None
    if skin.kind == "mesh":
        # Files have these packed; the page takes them as they are.
        return skin.model_dump(mode="json") | {
            "vertices": base64.b64encode(skin.vertices).decode("ascii"),
            "triangles": base64.b64encode(skin.triangles).decode("ascii"),
            "influences": base64.b64encode(skin.influences).decode("ascii"),
            "weights": base64.b64encode(skin.weights).decode("ascii"),
        }
    mesh = skin_mesh(skeleton)
    parts = []
    order = []
    first = 0
    for name, triangles in parts_of(skin, mesh).items():
        parts.append([name, 3 * first, 3 * len(triangles)])
        order.append(triangles)
        first += len(triangles)
    return {
        "positions": packed(mesh.points, "<f4"),
        "normals": packed(mesh.normals, "<f4"),
        "uvs": packed(_side_view(mesh.points), "<f4"),
        "colours": packed(colours_of(skin, mesh.shades), "<f4"),
        "indices": packed(mesh.triangles[np.concatenate(order)], "<u4"),
        "bones": packed(mesh.bones, "<u2"),
        "weights": packed(mesh.weights, "<f4"),
        "parts": parts,
    }


def describe_surface(skeleton: Skeleton) -> dict[str, Any] | None:
    """Return the nodes and shapes of a soft body, each array in base64 of little-endian numbers; None of another body.

    Float32 of `mean` (N, 3) [m] and of `scales` (K,); int16 of `modes` (K, N, 3), in units of their own scale; uint32 of
    `faces` (F, 3). Amplitudes [m] begin at the state entry `first`; `placement` says where the frame of all nodes is, -1
    where it does not. The `colour` is sRGB, as are the `colours` of nodes (N, 3), which replace it if they are not None.
    """
    shapes = skeleton.shapes
    if shapes is None:
        return None
    tensors = shapes.tensors()
    return {
        "mean": packed(tensors["mean"], "<f4"),
        "modes": packed(np.concatenate([tensors["modes"], tensors["fine_modes"]]), "<i2"),
        "scales": packed(tensors["scales"], "<f4"),
        "faces": packed(tensors["faces"], "<u4"),
        "first": shapes.first,
        "placement": asdict(shapes.placement),
        "colour": list(shapes.rgba[:3]),
        "colours": None if shapes.colours is None else packed(shapes.colours, "<f4"),
    }


def describe_movers(spec: EmulatorSpec) -> list[list[Any]]:
    """Return [name, entry, control entry, size] of each mover of a soft body.

    So many controls are the rates of its position [m] and, of one that turns, of its heading [rad]: as many numbers of a
    state. Of one that turns freely six controls are the rates of seven numbers, of which four are its quaternion.
    """
    if spec.skeleton.shapes is None:
        return []
    positions = [part.name for part in spec.state.slices if part.unit == "m" and part.size == 3]
    rows = []
    for part in spec.control.slices:
        if part.unit == "rad/s" and rows:
            rows[-1][3] += part.size
        elif part.name in positions:
            entry = spec.state.index(part.name).start
            rows.append([part.name, entry, spec.control.index(part.name).start, part.size])
    return rows


def short_numbers(numbers: np.ndarray) -> Any:
    """Return `numbers` as lists, with the digits that float32 has."""
    if numbers.ndim > 1:
        return [short_numbers(row) for row in numbers]
    return [float(f"{number:.{DIGITS}g}") for number in numbers]


def packed(numbers: np.ndarray, kind: str) -> str:
    """Return `numbers`, as NumPy calls the `kind`, in base64."""
    return base64.b64encode(np.ascontiguousarray(numbers, kind).tobytes()).decode("ascii")


def unpacked(text: str, kind: str) -> np.ndarray:
    """Return what `packed` wrote."""
    return np.frombuffer(base64.b64decode(text), kind)


def body_size(spec: EmulatorSpec) -> float:
    """Return the longest side [m] of the box around what moves, at rest; 1 where nothing is drawn.

    Of a soft body it is that of its surface alone: what strikes it may be far away.
    """
    skeleton = spec.skeleton
    if skeleton.shapes is not None:
        return float(np.ptp(skeleton.shapes.mean, axis=0).max())
    if skeleton.skin is not None:
        return float(np.ptp(skin_mesh(skeleton).points, axis=0).max())
    positions, _ = skeleton.world_poses(np.array(spec.rest)[None])
    corners = []
    for number, bone in enumerate(skeleton.bones):
        if not skeleton.is_moved(number):
            continue
        for shape in bone.shapes:
            reach = max(shape.size) + float(np.linalg.norm(shape.position))
            corners += [positions[0, number] - reach, positions[0, number] + reach]
    if not corners:
        return 1.0
    return float(np.ptp(corners, axis=0).max())


def describe_scene(spec: EmulatorSpec, system: System) -> dict[str, Any]:
    """Return the kind of place, and how high the water's surface and the ground are [m]; None where there is none."""
    is_own = bool(spec.definition)
    kind = "plain" if is_own else SHIPPED_SYSTEMS[system.name].scenery
    if system.structure.is_in_water:
        kind = "water"
    return {"kind": kind, "surface": system.water_surface, "floor": _floor(system)}


def _floor(system: System) -> float | None:
    """Return the height of the ground [m]; None where there is none."""
    if isinstance(system, SoftSystem):
        return system.ground_height
    if not isinstance(system, MujocoSystem):
        return 0.0 if system.has_ground else None
    import mujoco

    model = system.model
    is_plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    heights = model.geom_pos[is_plane & (model.geom_bodyid == 0), 2]
    return float(heights.max()) if len(heights) else None


def describe_goals(emulator: Emulator, system: System) -> list[dict[str, Any]]:
    """Return every goal: what `system` names, and to be at a place where something moves freely and no goal is named."""
    rows = []
    for name, goal in system.goals.items():
        rows.append(_named_goal(emulator, system, name, goal))
    if not rows and describe_root(emulator.state_structure) is not None:
        rows.append(target_goal(emulator, system))
    return rows


def _named_goal(emulator: Emulator, system: System, name: str, goal: Goal) -> dict[str, Any]:
    start = goal_start(system, name)
    target = goal_state(system, goal)
    within = []
    for (entry, value), tolerance in zip(goal.values, goal.tolerances, strict=False):
        within.append([entry, value, tolerance])
    return {
        "name": name,
        "kind": "state",
        "seconds": goal.seconds,
        "start": start.tolist(),
        "target": target.tolist(),
        "is_at_start": is_reached(system, goal, start),
        "movable": _movable(emulator, goal, target),
        "within": within,
    }


def _movable(
    emulator: Emulator, goal: Goal, target: Float[np.ndarray, " S"]
) -> dict[str, Any] | None:
    """Return the place that a goal's target may be dragged from; None where it says no place."""
    first = root_entry(emulator)
    if first is None:
        return None
    wanted = {entry for entry, _ in goal.values}
    if not wanted.issuperset(range(first, first + 3)):
        return None
    return {"kind": "place", "entry": first, "at": target[first : first + 3].tolist()}


def root_entry(body: Emulator | System) -> int | None:
    """Return the first of the three state entries of a rigid root's position; None of any other body."""
    structure = body.state_structure if isinstance(body, Emulator) else body.structure
    root = describe_root(structure)
    if root is None or root["kind"] != "free":
        return None
    return root["position"]


def target_goal(emulator: Emulator, system: System) -> dict[str, Any]:
    """Return the goal to be at a place, which may be dragged anywhere."""
    start = np.array(system.rest, float)
    length = system.body_length or body_size(emulator.spec)
    if system.water_surface is not None:
        first = root_entry(emulator)
        cloud = emulator.state_structure.cloud
        last = 3 * cloud.count if cloud is not None else 3 + (first or 0)
        heights = start[2 + (first or 0) : last : 3]
        heights += system.water_surface - BENEATH * length - heights.mean()
    position = np.asarray(read_pose(emulator.state_structure, start).position)
    at = position + length * np.array(TARGET_AWAY)
    return {
        "name": TARGET,
        "kind": "place",
        "seconds": TARGET_SECONDS,
        "start": start.tolist(),
        "target": None,
        "is_at_start": False,
        "movable": {"kind": "place", "entry": None, "at": at.tolist()},
        "within": {"distance": place_within(emulator.spec, system)},
    }


def place_within(spec: EmulatorSpec, system: System) -> float:
    """Return how near to a place counts as there [m]."""
    return TARGET_WITHIN * (system.body_length or body_size(spec))


def _title(emulator: Emulator) -> str:
    """Return what to call an emulator where there are several of one system."""
    return f"{emulator.system}, {emulator.substeps} steps at a time"


def _about(spec: EmulatorSpec) -> str:
    if not spec.definition and spec.system in SHIPPED_SYSTEMS:
        return SHIPPED_SYSTEMS[spec.system].about
    return f"{spec.system}: {spec.state.size} states, {spec.control.size} controls"


def _side_view(points: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 2"]:
    """Return texture coordinates from the side: 0 at the nose and at the belly."""
    low = points.min(axis=0)
    extent = np.ptp(points, axis=0)
    share = (points - low) / extent
    return np.stack([1 - share[:, 0], share[:, 2]], axis=1)


def _gait(spec: EmulatorSpec) -> dict[str, Any] | None:
    gait = spec.gait
    if gait is None:
        return None
    return {
        "period": gait.period,
        "amplitudes": list(gait.amplitudes),
        "lags": list(gait.lags),
    }
