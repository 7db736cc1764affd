"""Make the skin of the human: examples/human/skin/*.skn, which human.xml shows instead of its capsules.

pip install scikit-image fast-simplification
python -m tools.human_skin
python -m tools.human_skin dress examples/human/*.policy.safetensors  # policies learnt before he had one, or another

In earlier policies, `dress` rewrites the name of the physics and the look: the physics is the same.

The skin is only a look: MuJoCo gives it no mass and no contact. Each garment is a smooth union of cones and
ellipsoids in the frames of the bodies, with the arms slightly away from the trunk and the legs apart:

signed distances on a grid → marching cubes → fewer triangles → weights, smooth across the joints → a .skn file
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

from benchmarks.harness import HUMAN
from neuroanimator.files.atomic import canonical_json, read_tensors, write_tensors
from neuroanimator.physics import load_system
from neuroanimator.systems.model_files import read_model_files

BIND = {"shoulder_x": -0.52, "hip_x": -0.16, "elbow": 0.12}
"""Angles of the joints in the pose in which the skin is made, on both sides [rad]: arms and legs must not touch."""

LOOKS = {'  <include file="skin/skin.xml"/>\n': "", 'name="floor" group="0"': 'name="floor"'}
"""What human.xml says for its skin alone, and what stands there without one."""

STEP = 2.0**-15
"""Coordinates are multiples of this [m]: the files that carry a skin keep them so."""

WEIGHT = 255
"""Weights are multiples of one over this."""

LEAST = 3
"""Weights of fewer steps are left out."""

NAME_SIZE = 40
"""Number of bytes of a body's name in a .skn file."""

Points = Float[np.ndarray, "N 3"]
Distances = Float[np.ndarray, " N"]
"""Signed distances [m]: negative inside."""


class Frames:
    """The frames of the bodies in the bind pose; points are folded to the left half, for the human is his own mirror image."""

    def __init__(self, model: mujoco.MjModel):
        data = mujoco.MjData(model)
        for joint, angle in BIND.items():
            for side in ("left", "right"):
                data.joint(f"{joint}_{side}").qpos = angle
        mujoco.mj_kinematics(model, data)
        self.model = model
        self.positions = data.xpos
        self.orientations = data.xquat
        self._axes = data.xmat.reshape(-1, 3, 3)

    def local(self, body: str, points: Points) -> Points:
        """Return `points` in the frame of a body."""
        number = self.model.body(body).id
        return (points - self.positions[number]) @ self._axes[number]


def cone(
    points: Points, begin: tuple, end: tuple, first: float, last: float, flat: float = 1.0
) -> Distances:
    """Return the distances from a line that is `first` thick at its beginning and `last` at its end; along x `flat` times."""
    scale = np.array([1 / flat, 1.0, 1.0])
    start = np.array(begin) * scale
    along = np.array(end) * scale - start
    scaled = points * scale
    share = np.clip((scaled - start) @ along / (along @ along), 0, 1)
    axis = start + share[:, None] * along
    reach = np.linalg.norm(scaled - axis, axis=1) - (first + share * (last - first))
    return reach * min(flat, 1.0)


def ellipsoid(points: Points, centre: tuple, half: tuple, tilt: float = 0.0) -> Distances:
    """Return the distances, nearly, from an ellipsoid; `tilt` turns it about y [rad]."""
    moved = points - np.array(centre)
    if tilt:
        sine, cosine = np.sin(tilt), np.cos(tilt)
        x = cosine * moved[:, 0] - sine * moved[:, 2]
        z = sine * moved[:, 0] + cosine * moved[:, 2]
        moved = np.stack([x, moved[:, 1], z], axis=1)
    halves = np.array(half)
    length = np.linalg.norm(moved / halves, axis=1)
    slope = np.linalg.norm(moved / halves**2, axis=1)
    return length * (length - 1) / np.maximum(slope, 1e-9)


def union(*distances: Distances, blend: float = 0.03) -> Distances:
    """Return the smooth minimum, in whose corners there is about `blend` of filling [m]."""
    result = distances[0]
    for other in distances[1:]:
        share = np.clip(0.5 + 0.5 * (other - result) / blend, 0, 1)
        result = other + (result - other) * share - blend * share * (1 - share)
    return result


def without(distances: Distances, other: Distances, blend: float = 0.01) -> Distances:
    """Return the part that is not in the `other`."""
    return -union(-distances, other, blend=blend)


def trousers(frames: Frames, points: Points) -> Distances:
    pelvis = frames.local("pelvis", points)
    thigh = frames.local("thigh_left", points)
    shin = frames.local("shin_left", points)
    seat = union(
        ellipsoid(pelvis, (0.0, 0.0, 0.075), (0.105, 0.148, 0.13)),
        ellipsoid(pelvis, (-0.005, 0.03, -0.01), (0.115, 0.135, 0.11)),
        ellipsoid(pelvis, (-0.055, 0.07, -0.025), (0.075, 0.075, 0.085)),
        blend=0.04,
    )
    leg = union(
        cone(thigh, (0.0, 0.018, -0.05), (0.004, 0.0, -0.36), 0.09, 0.064),
        ellipsoid(thigh, (0.02, 0.012, -0.16), (0.068, 0.07, 0.15)),
        cone(shin, (0.006, 0.0, 0.0), (-0.008, 0.0, -0.2), 0.063, 0.06),
        ellipsoid(shin, (-0.022, 0.004, -0.12), (0.052, 0.055, 0.11)),
        cone(shin, (-0.008, 0.0, -0.2), (0.0, 0.0, -0.4), 0.06, 0.058),
        blend=0.03,
    )
    body = union(seat, leg, blend=0.035)
    body = without(body, 0.115 - pelvis[:, 2], blend=0.008)
    return without(body, shin[:, 2] + 0.352, blend=0.008)


def shirt(frames: Frames, points: Points) -> Distances:
    torso = frames.local("torso", points)
    arm = frames.local("upper_arm_left", points)
    trunk = union(
        ellipsoid(torso, (-0.008, 0.0, -0.06), (0.132, 0.17, 0.16)),
        ellipsoid(torso, (0.0, 0.0, 0.1), (0.102, 0.143, 0.17)),
        ellipsoid(torso, (-0.012, 0.0, 0.265), (0.118, 0.165, 0.15)),
        ellipsoid(torso, (0.05, 0.07, 0.285), (0.062, 0.08, 0.065)),
        ellipsoid(torso, (-0.06, 0.075, 0.3), (0.06, 0.085, 0.1)),
        blend=0.05,
    )
    yoke = union(
        cone(torso, (-0.012, 0.03, 0.385), (-0.008, 0.15, 0.362), 0.068, 0.056),
        cone(torso, (-0.026, 0.015, 0.44), (-0.012, 0.15, 0.378), 0.054, 0.047),
        ellipsoid(arm, (0.0, -0.006, -0.03), (0.055, 0.05, 0.062)),
        blend=0.04,
    )
    sleeve = union(
        cone(arm, (0.0, -0.004, -0.02), (0.0, 0.002, -0.19), 0.05, 0.057),
        ellipsoid(arm, (0.002, -0.002, -0.06), (0.06, 0.054, 0.085)),
        blend=0.03,
    )
    sleeve = without(sleeve, arm[:, 2] + 0.175, blend=0.008)
    body = union(trunk, yoke, blend=0.045)
    body = union(body, sleeve, blend=0.028)
    body = without(body, torso[:, 2] + 0.105, blend=0.01)
    collar = cone(torso, (0.012, 0.0, 0.5), (-0.004, 0.0, 0.415), 0.072, 0.058)
    return without(body, collar, blend=0.012)


def head(frames: Frames, points: Points) -> Distances:
    torso = frames.local("torso", points)
    skull = union(
        ellipsoid(torso, (0.004, 0.0, 0.645), (0.094, 0.074, 0.088)),
        ellipsoid(torso, (0.04, 0.0, 0.6), (0.064, 0.06, 0.085)),
        ellipsoid(torso, (0.044, 0.0, 0.548), (0.05, 0.045, 0.042)),
        ellipsoid(torso, (0.083, 0.0, 0.518), (0.018, 0.022, 0.016)),
        ellipsoid(torso, (0.064, 0.034, 0.578), (0.03, 0.023, 0.028)),
        blend=0.024,
    )
    face = union(
        skull,
        ellipsoid(torso, (0.088, 0.026, 0.629), (0.014, 0.032, 0.009)),
        ellipsoid(torso, (0.094, 0.0, 0.546), (0.012, 0.022, 0.007)),
        ellipsoid(torso, (0.092, 0.0, 0.535), (0.012, 0.018, 0.007)),
        blend=0.014,
    )
    face = without(face, ellipsoid(torso, (0.11, 0.031, 0.607), (0.018, 0.019, 0.011)), blend=0.014)
    nose = union(
        cone(torso, (0.1, 0.0, 0.618), (0.119, 0.0, 0.576), 0.008, 0.0105),
        ellipsoid(torso, (0.107, 0.01, 0.572), (0.011, 0.008, 0.008)),
        blend=0.008,
    )
    face = union(face, nose, blend=0.012)
    ear = ellipsoid(torso, (-0.004, 0.078, 0.597), (0.017, 0.008, 0.031), tilt=0.2)
    ear = without(
        ear, ellipsoid(torso, (0.0, 0.088, 0.599), (0.009, 0.008, 0.017), tilt=0.2), blend=0.006
    )
    face = union(face, ear, blend=0.008)
    neck = union(
        cone(torso, (-0.022, 0.0, 0.38), (-0.008, 0.0, 0.57), 0.058, 0.05),
        cone(torso, (0.002, 0.022, 0.41), (-0.02, 0.04, 0.55), 0.022, 0.022),
        ellipsoid(torso, (-0.02, 0.0, 0.4), (0.06, 0.1, 0.03)),
        blend=0.03,
    )
    whole = union(face, neck, blend=0.022)
    return without(whole, torso[:, 2] - 0.385, blend=0.005)


def hair(frames: Frames, points: Points) -> Distances:
    torso = frames.local("torso", points)
    cap = union(
        ellipsoid(torso, (0.0, 0.0, 0.653), (0.101, 0.081, 0.088)),
        ellipsoid(torso, (-0.024, 0.0, 0.618), (0.082, 0.077, 0.08)),
        ellipsoid(torso, (0.05, 0.0, 0.695), (0.05, 0.056, 0.036)),
        blend=0.025,
    )
    # The hairline: over the forehead, down before the ears, around them and to the nape.
    forehead = 0.55 * (torso[:, 0] - 0.078) - 0.83 * (torso[:, 2] - 0.672)
    temple = np.minimum(torso[:, 0] - 0.036 - 0.25 * (torso[:, 2] - 0.63), 0.672 - torso[:, 2])
    nape = 0.552 - torso[:, 2] + 0.9 * np.maximum(torso[:, 0] + 0.05, 0)
    bald = np.maximum(forehead, np.maximum(temple, nape))
    return without(cap, -bald, blend=0.012)


def painted(distances: Distances, region: Distances, thickness: float) -> Distances:
    """Return the part of a surface that lies in a region of space, as a thin layer on it."""
    return np.maximum(np.maximum(distances - thickness, -thickness - 0.004 - distances), region)


def brows(frames: Frames, points: Points) -> Distances:
    torso = frames.local("torso", points) * [0.0, 1.0, 1.0]
    arch = union(
        cone(torso, (0.0, 0.013, 0.629), (0.0, 0.033, 0.635), 0.0045, 0.0045),
        cone(torso, (0.0, 0.033, 0.635), (0.0, 0.05, 0.629), 0.0045, 0.0025),
        blend=0.004,
    )
    return painted(
        head(frames, points), np.maximum(arch, -frames.local("torso", points)[:, 0]), 0.002
    )


def lips(frames: Frames, points: Points) -> Distances:
    torso = frames.local("torso", points)
    mouth = ellipsoid(torso, (0.1, 0.0, 0.5405), (0.03, 0.024, 0.0095))
    return painted(head(frames, points), mouth, 0.0008)


EYE = (0.09, 0.0305, 0.607)
"""Middle of the left eye in the torso's frame [m]."""


def eyes(frames: Frames, points: Points) -> Distances:
    torso = frames.local("torso", points)
    return ellipsoid(torso, EYE, (0.0105, 0.0125, 0.0068))


def irises(frames: Frames, points: Points) -> Distances:
    torso = frames.local("torso", points)
    circle = np.hypot(torso[:, 1] - EYE[1], torso[:, 2] - EYE[2]) - 0.0052
    return painted(eyes(frames, points), np.maximum(circle, EYE[0] - torso[:, 0]), 0.0006)


def arms(frames: Frames, points: Points) -> Distances:
    upper = frames.local("upper_arm_left", points)
    lower = frames.local("forearm_left", points)
    limb = union(
        cone(upper, (0.0, 0.0, -0.09), (0.0, 0.0, -0.25), 0.048, 0.039),
        ellipsoid(upper, (0.014, 0.0, -0.13), (0.038, 0.04, 0.09)),
        cone(lower, (0.0, 0.0, 0.0), (0.002, 0.0, -0.12), 0.039, 0.037),
        ellipsoid(lower, (0.004, 0.008, -0.06), (0.042, 0.042, 0.075)),
        cone(lower, (0.002, 0.0, -0.12), (0.004, 0.0, -0.25), 0.037, 0.026),
        blend=0.02,
    )
    palm = union(
        ellipsoid(lower, (0.006, -0.002, -0.295), (0.04, 0.019, 0.055)),
        cone(lower, (0.004, 0.0, -0.24), (0.006, 0.0, -0.29), 0.025, 0.022, flat=1.25),
        blend=0.02,
    )
    fingers = []
    for number, x in enumerate((0.032, 0.012, -0.008, -0.026)):
        length = (0.072, 0.082, 0.076, 0.058)[number]
        knuckle = (x, -0.002, -0.325)
        middle = (x * 0.98 + 0.001, -0.012, -0.325 - 0.55 * length)
        tip = (x * 0.95 + 0.001, -0.032, -0.325 - 0.95 * length)
        fingers.append(cone(lower, knuckle, middle, 0.0115, 0.0105))
        fingers.append(cone(lower, middle, tip, 0.0105, 0.0085))
    thumb = union(
        cone(lower, (0.022, -0.008, -0.262), (0.05, -0.022, -0.3), 0.016, 0.013),
        cone(lower, (0.05, -0.022, -0.3), (0.058, -0.032, -0.335), 0.012, 0.009),
        blend=0.012,
    )
    hand = union(palm, union(*fingers, blend=0.004), blend=0.014)
    hand = union(hand, thumb, blend=0.014)
    whole = union(limb, hand, blend=0.02)
    return without(whole, -0.09 - upper[:, 2], blend=0.005)


def shoe(frames: Frames, points: Points) -> Distances:
    foot = frames.local("foot_left", points)
    foot = np.stack([foot[:, 0], foot[:, 1] - 0.004 - 0.05 * foot[:, 0], foot[:, 2]], axis=1)
    upper = union(
        ellipsoid(foot, (-0.03, 0.0, -0.025), (0.047, 0.036, 0.042)),
        cone(foot, (0.02, 0.0, -0.02), (0.13, 0.0, -0.052), 0.042, 0.036),
        ellipsoid(foot, (0.13, 0.002, -0.055), (0.078, 0.048, 0.032)),
        cone(foot, (-0.012, 0.0, 0.035), (-0.008, 0.0, -0.02), 0.041, 0.042),
        ellipsoid(foot, (0.05, 0.0, -0.06), (0.12, 0.04, 0.03)),
        blend=0.03,
    )
    return without(upper, foot[:, 2] + 0.062, blend=0.004)


def sole(frames: Frames, points: Points) -> Distances:
    foot = frames.local("foot_left", points)
    foot = np.stack([foot[:, 0], foot[:, 1] - 0.004 - 0.05 * foot[:, 0], foot[:, 2]], axis=1)
    level = foot * [1.0, 1.0, 0.0]
    print_ = union(
        ellipsoid(level, (-0.034, 0.0, 0.0), (0.05, 0.039, 0.05)),
        ellipsoid(level, (0.135, 0.003, 0.0), (0.08, 0.052, 0.05)),
        ellipsoid(level, (0.04, 0.0, 0.0), (0.11, 0.036, 0.05)),
        blend=0.03,
    )
    toe = 0.1 * np.maximum(foot[:, 0] - 0.12, 0)
    height = np.abs(foot[:, 2] + 0.0645 - toe) - 0.0105
    return -union(-print_, -height, blend=0.008)


class Piece(NamedTuple):
    """A closed surface."""

    distance: Callable[[Frames, Points], Distances]
    spacing: float
    """Distance of the grid's points [m]."""
    triangles: int
    """Number of triangles that are left, about."""
    bodies: tuple[str, ...]
    """Bodies that it may follow, those of the left."""


SKINS = {
    "skin": (
        Piece(head, 0.0035, 1700, ("torso",)),
        Piece(arms, 0.0045, 1700, ("upper_arm", "forearm")),
    ),
    "hair": (
        Piece(hair, 0.006, 420, ("torso",)),
        Piece(brows, 0.0018, 140, ("torso",)),
    ),
    "eyes": (Piece(eyes, 0.002, 100, ("torso",)),),
    "irises": (Piece(irises, 0.0009, 60, ("torso",)),),
    "lips": (Piece(lips, 0.0015, 100, ("torso",)),),
    "shirt": (Piece(shirt, 0.009, 1300, ("pelvis", "torso", "thigh", "upper_arm")),),
    "trousers": (Piece(trousers, 0.009, 1300, ("pelvis", "torso", "thigh", "shin")),),
    "shoes": (Piece(shoe, 0.005, 500, ("shin", "foot")),),
    "soles": (Piece(sole, 0.005, 300, ("foot",)),),
}
"""The pieces of each skin: MuJoCo gives a skin one colour, which skin.xml says."""

LOW = np.array([-0.3, -0.62, -0.02])
HIGH = np.array([0.35, 0.62, 1.78])
"""Corners of the box that the human stands in, in the bind pose [m]."""

COARSE = 0.02
"""Distance of the points by which a garment is looked for [m]."""


def main() -> None:
    """Write a file of each skin, or dress the files that the command line names."""
    if sys.argv[1:2] == ["dress"]:
        for name in sys.argv[2:]:
            dress(Path(name))
        return
    model = mujoco.MjModel.from_xml_string(bare_text())
    frames = Frames(model)
    total = 0
    for name, pieces in SKINS.items():
        content = skn(frames, [surface(frames, piece) for piece in pieces])
        (HUMAN / "skin" / f"{name}.skn").write_bytes(content)
        total += len(content)
        print(f"{name}: {len(content)} bytes")
    print(f"{total} bytes")


class Surface(NamedTuple):
    """A surface and what it follows."""

    points: Points
    triangles: Int[np.ndarray, "M 3"]
    """Counterclockwise from outside."""
    weights: dict[str, Distances]
    """Of each body, in steps of one over `WEIGHT`."""


def surface(frames: Frames, piece: Piece) -> Surface:
    """Return a piece of the skin."""
    # Tools of this script alone, which those who only dress a policy need not have.
    import fast_simplification
    from skimage.measure import marching_cubes

    def distances(points: Points) -> Distances:
        folded = np.stack([points[:, 0], np.abs(points[:, 1]), points[:, 2]], axis=1)
        return piece.distance(frames, folded)

    low, high = _box(distances)
    axes = []
    for begin, end in zip(low, high, strict=True):
        half = (end - begin) / 2
        steps = int(np.ceil(half / piece.spacing))
        axes.append((begin + end) / 2 + piece.spacing * np.arange(-steps, steps + 1))
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = distances(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    points, faces, _, _ = marching_cubes(values, 0.0, spacing=(piece.spacing,) * 3)
    points = points + grid[0, 0, 0]
    points, faces = fast_simplification.simplify(
        points.astype(np.float32), faces.astype(np.int32), target_count=piece.triangles, agg=4
    )
    points = np.round(points.astype(float) / STEP) * STEP
    faces = faces.astype(int)
    if volume(points, faces) < 0:
        faces = faces[:, ::-1]
    return Surface(points, faces, weights_of(frames, piece, points))


def volume(points: Points, faces: Int[np.ndarray, "M 3"]) -> float:
    first, second, third = (points[faces[:, corner]] for corner in range(3))
    return float((first * np.cross(second, third)).sum()) / 6


def _box(distances: Callable[[Points], Distances]) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners [m] of a box around what is inside, on both sides."""
    axes = [np.arange(begin, end, COARSE / 2) for begin, end in zip(LOW, HIGH, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = grid[distances(grid) < COARSE / 2]
    low = inside.min(axis=0) - COARSE
    high = inside.max(axis=0) + COARSE
    widest = max(-low[1], high[1])
    low[1], high[1] = -widest, widest
    return low, high


def bare_text() -> str:
    """Return human.xml without his skin."""
    text = (HUMAN / "human.xml").read_text()
    for with_skin, without_skin in LOOKS.items():
        text = text.replace(with_skin, without_skin)
    return text


def dress(path: Path) -> None:
    """Let an emulator or a policy in a file name the model with today's skin, and carry that."""
    tensors, metadata = read_tensors(path, "emulator", "policy", "state-policy")
    emulator = metadata.get("emulator", metadata)
    carried = json.loads(emulator["definition"])
    named = carried["files"]
    files = read_model_files(HUMAN / named["main"])
    bare = hashlib.sha256(bare_text().encode()).hexdigest()
    for name, digest in named["sha256"].items():
        same = [files.digests.get(name), bare if name == "human.xml" else None]
        if digest not in same and not name.startswith("skin/"):
            sys.exit(
                f"{path}: its {name} differs from this one by more than the skin. Train again."
            )
    named["sha256"] = files.digests
    emulator["definition"] = canonical_json(carried)
    emulator["skeleton"] = load_system(str(HUMAN / named["toml"])).skeleton.to_json()
    metadata.pop("sha256", None)
    write_tensors(path, tensors, metadata)
    print(f"{path}: {path.stat().st_size} bytes")


def smooth_step(share: Distances) -> Distances:
    """Return 0 below 0, 1 above 1 and a smooth step between."""
    share = np.clip(share, 0, 1)
    return share * share * (3 - 2 * share)


def weights_of(frames: Frames, piece: Piece, points: Points) -> dict[str, Distances]:
    """Return how much the vertices follow each body, in steps of one over `WEIGHT`."""
    is_right = points[:, 1] < 0
    folded = np.stack([points[:, 0], np.abs(points[:, 1]), points[:, 2]], axis=1)
    shares = _shares(frames, piece.bodies, folded)
    across = shares.pop("other thigh")
    weights = {name: shares.pop(name) for name in ("pelvis", "torso")}
    for side, is_own in (("right", is_right), ("left", ~is_right)):
        for name, share in shares.items():
            weights[f"{name}_{side}"] = np.where(is_own, share, 0.0)
        weights[f"thigh_{side}"] += np.where(is_own, 0.0, across)
    return _rounded(weights)


def _shares(frames: Frames, bodies: tuple[str, ...], points: Points) -> dict[str, Distances]:
    """Return how much points of the left half follow the bodies there, and the thigh of the other side.

    At every joint a point follows what is beyond it the more the farther it is that way.
    """
    torso_height = frames.local("torso", points)[:, 2]
    thigh_height = frames.local("thigh_left", points)[:, 2]
    shin_height = frames.local("shin_left", points)[:, 2]
    upper_arm = frames.local("upper_arm_left", points)
    arm_height = upper_arm[:, 2]
    off_arm = np.linalg.norm(upper_arm[:, :2], axis=1)
    # The trunk's sides are beside the arm and no part of it.
    beside_arm = smooth_step((off_arm - 0.062) / 0.05)
    # Between the legs a point follows both.
    width = 0.012 + 0.05 * smooth_step((thigh_height + 0.14) / 0.1)
    across = 1 - smooth_step(0.5 + 0.5 * points[:, 1] / width)

    def beyond(share: Distances, near: set[str], far: set[str]) -> Distances:
        """Return the share of what is beyond a joint, as far as the piece may follow both sides of it."""
        if not far & {*bodies}:
            return np.zeros(len(points))
        if not near & {*bodies}:
            return np.ones(len(points))
        return share

    trunk = {"pelvis", "torso"}
    torso = beyond(smooth_step((torso_height + 0.09) / 0.18), {"pelvis"}, {"torso"})
    arm = smooth_step((0.055 - arm_height) / 0.13) * (1 - beside_arm)
    arm = beyond(arm, trunk, {"upper_arm", "forearm"})
    elbow = beyond(smooth_step((-0.213 - arm_height) / 0.09), {"upper_arm"}, {"forearm"})
    leg = beyond(smooth_step((0.05 - thigh_height) / 0.17), trunk, {"thigh", "shin", "foot"})
    knee = beyond(smooth_step((-0.321 - thigh_height) / 0.12), {"thigh"}, {"shin", "foot"})
    ankle = beyond(smooth_step((-0.356 - shin_height) / 0.05), {"shin"}, {"foot"})
    of_trunk = (1 - arm) * (1 - leg)
    of_leg = (1 - arm) * leg
    return {
        "pelvis": of_trunk * (1 - torso),
        "torso": of_trunk * torso,
        "thigh": of_leg * (1 - knee) * (1 - across),
        "other thigh": of_leg * (1 - knee) * across,
        "shin": of_leg * knee * (1 - ankle),
        "foot": of_leg * knee * ankle,
        "upper_arm": arm * (1 - elbow),
        "forearm": arm * elbow,
    }


def _rounded(weights: dict[str, Distances]) -> dict[str, Distances]:
    """Return weights in whole steps that add up to one, four at most of a vertex."""
    table = np.stack(list(weights.values()), axis=1)
    fourth = np.sort(table, axis=1)[:, -4]
    table[table < np.maximum(fourth, LEAST / WEIGHT)[:, None]] = 0
    table /= table.sum(axis=1, keepdims=True)
    whole = np.round(table * WEIGHT)
    rows = np.arange(len(table))
    whole[rows, table.argmax(axis=1)] += WEIGHT - whole.sum(axis=1)
    return {name: column for name, column in zip(weights, whole.T, strict=True) if column.any()}


def skn(frames: Frames, surfaces: list[Surface]) -> bytes:
    """Return the bytes of a .skn file (MuJoCo's XML reference, asset/skin)."""
    points = np.concatenate([one.points for one in surfaces])
    triangles = []
    followers: dict[str, list[np.ndarray]] = {}
    steps: dict[str, list[np.ndarray]] = {}
    first = 0
    for one in surfaces:
        triangles.append(one.triangles + first)
        for body, weights in one.weights.items():
            rows = np.flatnonzero(weights)
            followers.setdefault(body, []).append(rows + first)
            steps.setdefault(body, []).append(weights[rows])
        first += len(one.points)
    faces = np.concatenate(triangles)
    content = [np.array([len(points), 0, len(faces), len(followers)], "<i4").tobytes()]
    content.append(points.astype("<f4").tobytes())
    content.append(faces.astype("<i4").tobytes())
    for name in followers:
        body = frames.model.body(name).id
        rows = np.concatenate(followers[name])
        content.append(name.encode().ljust(NAME_SIZE, b"\0"))
        content.append(frames.positions[body].astype("<f4").tobytes())
        content.append(frames.orientations[body].astype("<f4").tobytes())
        content.append(np.array([len(rows)], "<i4").tobytes())
        content.append(rows.astype("<i4").tobytes())
        content.append((np.concatenate(steps[name]) / WEIGHT).astype("<f4").tobytes())
    return b"".join(content)


if __name__ == "__main__":
    main()
