"""A made-up character as GLB: a trunk with two arms in one skin, who walks along a circle and swings his arms."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from neuroanimator.export.gltf.buffers import Buffer, as_float32, glb_bytes

SECONDS = 6.0

JOINTS = {"trunk": (0.0, 0.25, 0.6), "arm.L": (-0.2, 0.25, 0.9), "arm.R": (0.2, 0.25, 0.9)}
"""Places of the joints in the pose to which the skin is bound [m], Z up."""

ENDS = {"trunk": (0.0, 0.25, 0.95), "arm.L": (-0.4, 0.25, 0.7), "arm.R": (0.4, 0.25, 0.7)}
"""Other ends of the limbs there [m]."""

RADII = {"trunk": 0.1, "arm.L": 0.04, "arm.R": 0.04}
"""Their radii [m]."""

TWIST = Rotation.from_euler("xyz", [0.3, -0.2, 0.5])
"""Turn of the arms' own axes in that pose, which no result may depend on."""

NAMESPACE = "rig:"
"""What the names of the nodes begin with, as those of Mixamo do."""


def trunk_at(time: float) -> tuple[np.ndarray, Rotation]:
    """Return where the trunk is [m] and how it is turned since the skin was bound, Z up."""
    angle = 0.5 * time
    return np.array([np.sin(angle), 1.25 - np.cos(angle), 0.6]), Rotation.from_euler("z", angle)


def arm_turned(name: str, time: float) -> Rotation:
    """Return how an arm is turned against the trunk since then, Z up."""
    side = 1 if name == "arm.L" else -1
    return Rotation.from_euler("x", side * 0.4 * np.sin(3 * time))


def write_character(
    path: Path,
    left_at: float = 0.0,
    forge: Callable[[dict[str, Any]], object] = lambda document: None,
) -> Path:
    """Write the character, whose nodes are left in his pose at the time `left_at` [s]; return `path`."""
    buffer = Buffer()
    times = np.linspace(0, SECONDS, 181)
    trunk = [trunk_at(time) for time in times]
    tracks = {
        (0, "translation"): np.array([y_up(place) for place, _ in trunk]),
        (0, "rotation"): np.array([_y_up_rotation(turn).as_quat() for _, turn in trunk]),
    }
    nodes: list[dict[str, Any]] = [{"name": NAMESPACE + "trunk", "children": [1, 2]}]
    for number, name in enumerate(("arm.L", "arm.R"), start=1):
        turns = [_y_up_rotation(arm_turned(name, time)) * TWIST for time in times]
        tracks[number, "rotation"] = np.array([turn.as_quat() for turn in turns])
        away = y_up(np.subtract(JOINTS[name], JOINTS["trunk"]))
        nodes.append({"name": NAMESPACE + name, "translation": away.tolist()})
    left = int(np.abs(times - left_at).argmin())
    clock = buffer.add(as_float32(times), "SCALAR")
    samplers = []
    channels = []
    for (node, kind), values in tracks.items():
        nodes[node][kind] = values[left].tolist()
        output = buffer.add(as_float32(values), f"VEC{values.shape[1]}")
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": kind}})
        samplers.append({"input": clock, "output": output})
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    backs = []
    points = []
    joints = []
    for number, name in enumerate(JOINTS):
        matrix = np.eye(4)
        matrix[:3, 3] = y_up(JOINTS[name])
        if number:
            matrix[:3, :3] = TWIST.as_matrix()
        backs.append(np.linalg.inv(matrix).T.ravel())
        around = surface_points(name)
        points.append(np.array([y_up(point) for point in around]))
        joints += [[0, 0, 0, number]] * len(around)
    weights = np.tile([0.2, 0.0, 0.0, 0.8], (len(joints), 1))
    attributes = {
        "POSITION": buffer.add(as_float32(np.concatenate(points)), "VEC3"),
        "JOINTS_0": buffer.add(np.array(joints, np.uint8), "VEC4"),
        "WEIGHTS_0": buffer.add(as_float32(weights), "VEC4"),
    }
    matrices = buffer.add(as_float32(np.array(backs)), "MAT4")
    document = {
        "asset": {"version": "2.0"},
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": attributes}] * 2}],
        "skins": [{"joints": [0, 1, 2], "inverseBindMatrices": matrices}],
        "animations": [{"channels": channels, "samplers": samplers}],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    forge(document)
    path.write_bytes(glb_bytes(document, bytes(buffer.content)))
    return path


def surface_points(name: str) -> np.ndarray:
    """Return points of a limb's surface in the pose to which it is bound [m], Z up."""
    start, end = np.array(JOINTS[name]), np.array(ENDS[name])
    rng = np.random.default_rng(0)
    away = rng.normal(size=(400, 3))
    along = (end - start) / np.linalg.norm(end - start)
    away -= (away @ along)[:, None] * along
    away *= RADII[name] / np.linalg.norm(away, axis=1, keepdims=True)
    return start + rng.random((400, 1)) * (end - start) + away


def y_up(vector: Any) -> np.ndarray:
    """Return a vector along the axes of glTF."""
    x, y, z = vector
    return np.array([x, z, -y])


def _y_up_rotation(turn: Rotation) -> Rotation:
    return Rotation.from_rotvec(y_up(turn.as_rotvec()))
