"""Motion of a GLB file's node through the world, in the file's first animation.

glTF is Y up and writes quaternions xyzw; the result is Z up and wxyz, as everywhere in the package: (x, y, z) → (x, -z, y).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.glb_rig import (
    MAX_LENGTH_ERROR,
    MAX_VALUE,
    WIDTHS,
    Rig,
    properties_of,
    taken_apart,
    z_up,
)
from neuroanimator.animation.interpolate import hermite_cubic
from neuroanimator.files.clock import resolution_of, straightened
from neuroanimator.files.glb import Glb, object_at, objects_in
from neuroanimator.files.numbers import whole
from neuroanimator.state.rotation import conjugate, multiply, rotate
from neuroanimator.text import did_you_mean, listed, quoted

SAMPLING = 1 / 120
"""Time between two samples [s]; every keyframe is sampled, too."""

MAX_SECONDS = 3600.0
"""Maximum duration of a motion [s]."""

MAX_POSES = 20_000_000
"""Maximum number of samples times that of nodes above the one asked for: an hour of 46 nodes."""

MAX_KEYFRAMES = 20_000_000
"""Maximum number of keyframes of all properties together, of which many may share their times."""

PROPERTIES = list(WIDTHS)
"""The names as a list, in which any value from a file can be looked up."""

CUBIC_VALUES = 3
"""Number of values per keyframe of a cubic spline: in-tangent, value, out-tangent."""


@dataclass(frozen=True, eq=False)
class Track:
    """Values of one property at keyframes."""

    times: Float[np.ndarray, " K"]
    """Increasing times [s]."""
    values: Float[np.ndarray, "R W"]
    """One per keyframe; `CUBIC_VALUES` for cubics."""
    interpolation: str
    is_rotation: bool

    def at(self, times: Float[np.ndarray, " F"]) -> Float[np.ndarray, "F W"]:
        """Return the values at `times` [s], constant before the first keyframe and after the last."""
        times = np.clip(times, self.times[0], self.times[-1])
        before = np.searchsorted(self.times, times, side="right") - 1
        if self.interpolation == "STEP":
            return self.values[before]
        if self.interpolation == "LINEAR" and self.is_rotation:
            from scipy.spatial.transform import Rotation, Slerp  # it takes long to import

            return Slerp(self.times, Rotation.from_quat(self.values))(times).as_quat()
        first = np.minimum(before, len(self.times) - 2)
        span = np.diff(self.times)[first, None]
        share = (times - self.times[first])[:, None] / span
        if self.interpolation == "LINEAR":
            return (1 - share) * self.values[first] + share * self.values[first + 1]
        # Hermite's cubics; see the glTF specification, appendix C.
        coming, keys, leaving = np.moveaxis(
            self.values.reshape(len(self.times), CUBIC_VALUES, -1), 1, 0
        )
        ends = (keys[first], keys[first + 1])
        values = hermite_cubic(share, *ends, span * leaving[first], span * coming[first + 1])
        if self.is_rotation:
            values /= np.linalg.norm(values, axis=1, keepdims=True)
        return values


Moving = dict[str, Track]
"""The properties of a node relative to its parent, by their names."""


def node_motion(
    rig: Rig, name: str
) -> tuple[Float[np.ndarray, " F"], Float[np.ndarray, "F 3"], Float[np.ndarray, "F 4"]]:
    """Return times [s], positions [m] and orientations of the node called `name` along the first animation.

    An orientation is the node's rotation in the world, relative to the pose to which the skin is bound if it is a joint of
    one, and otherwise to its pose without the animation. Raises ValueError with what is wrong with the file.
    """
    file = rig.file
    chain = rig.chain(_numbered(rig.nodes, name))
    animations = file.objects("animations")
    if not animations:
        raise ValueError("no animation. Export the character with its animation")
    tracks, end = _tracks(file, animations[0], chain)
    if not any(tracks.values()):
        raise ValueError(f"the first animation moves neither {quoted(name)} nor any node above it")
    times = _sampled(tracks, end)
    moving = [_still(properties_of(rig.nodes[node], node)) | tracks[node] for node in chain]
    positions, orientations = _in_world(moving, times)
    rest = np.roll(taken_apart(rig.bound(chain[0]), quoted(name))["rotation"], 1)
    turned = multiply(orientations, np.broadcast_to(conjugate(rest), orientations.shape))
    upright = np.concatenate([turned[:, :1], z_up(turned[:, 1:])], axis=1)
    return times, z_up(positions), upright


def _still(properties: dict[str, np.ndarray]) -> Moving:
    """Return properties that do not change, as tracks of one key."""
    start = np.zeros(1)
    return {
        name: Track(start, value[None], "STEP", is_rotation=False)
        for name, value in properties.items()
    }


def _sampled(tracks: dict[int, Moving], end: float) -> Float[np.ndarray, " F"]:
    """Return every time [s] at which the motion is looked at: few enough of them, whatever the file says."""
    every = [track for of_node in tracks.values() for track in of_node.values()]
    keys = {id(track.times): track.times for track in every}
    most = min(MAX_SECONDS, SAMPLING * MAX_POSES / len(tracks))
    count = sum(len(times) for times in keys.values())
    if end > most or count * len(tracks) > MAX_POSES:
        raise ValueError(
            f"an animation of {end:g} s with {count:,} keyframes; of a node with {len(tracks) - 1} above it at most "
            f"{most:.0f} s are read. Cut it into parts"
        )
    return np.unique(np.concatenate([np.arange(0.0, end, SAMPLING), *keys.values(), [0.0, end]]))


def _numbered(nodes: list[dict[str, Any]], name: str) -> int:
    names = [node.get("name") for node in nodes]
    count = names.count(name)
    if count == 1:
        return names.index(name)
    if count > 1:
        raise ValueError(f"{count} nodes are called {quoted(name)}. Rename all but one")
    known = sorted({known for known in names if isinstance(known, str)})
    raise ValueError(
        f"no node called {quoted(name)}. {did_you_mean(name, known)}Nodes: {listed(known) or 'none'}"
    )


def _tracks(
    file: Glb, animation: dict[str, Any], chain: list[int]
) -> tuple[dict[int, Moving], float]:
    """Return the tracks of each node in the chain by property, and the time at which the animation ends [s]."""
    samplers = objects_in(animation, "samplers")
    # the end: that of the longest
    end = 0.0
    inputs = {sampler.get("input") for sampler in samplers if _is_index(sampler.get("input"))}
    for index in inputs:
        end = max(end, float(file.array(index, "SCALAR", is_last_alone=True)[0, 0]))
    # keyframes: only those that move the chain
    tracks: dict[int, Moving] = {number: {} for number in chain}
    times: dict[int, np.ndarray] = {}
    keyframes = 0
    for channel in objects_in(animation, "channels"):
        target = channel.get("target")
        if not isinstance(target, dict):
            raise ValueError("an animation channel without a target")
        node = target.get("node")
        name = target.get("path")
        if not _is_index(node) or node not in tracks or name not in PROPERTIES:
            continue
        if name in tracks[node]:
            raise ValueError(f"two channels for the {name} of node {node}")
        sampler = object_at(samplers, channel.get("sampler"), "sampler")
        index = whole(sampler.get("input"), "sampler: input", 0, len(file.objects("accessors")) - 1)
        if index not in times:
            times[index] = _rising(file.array(index, "SCALAR")[:, 0])
        keyframes += len(times[index])
        if keyframes > MAX_KEYFRAMES:
            raise ValueError(
                f"more than {MAX_KEYFRAMES:,} keyframes for one node. Cut it into parts"
            )
        tracks[node][name] = _track(file, sampler, name, times[index])
    return tracks, end


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _rising(times: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    if times[0] < 0 or times[-1] > MAX_VALUE or (np.diff(times) <= 0).any():
        raise ValueError("keyframe times that do not rise, or are negative")
    return straightened(times, resolution_of(times.astype(np.float32)))


def _track(file: Glb, sampler: dict[str, Any], name: str, times: np.ndarray) -> Track:
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise ValueError(f"unknown interpolation {quoted(interpolation)}")
    values = file.array(sampler.get("output"), f"VEC{WIDTHS[name]}")
    rows = CUBIC_VALUES if interpolation == "CUBICSPLINE" else 1
    if len(values) != rows * len(times):
        raise ValueError(f"{name}: {len(values)} values at {len(times)} keyframes")
    if np.abs(values).max() > MAX_VALUE:
        raise ValueError(f"{name}: a number above {MAX_VALUE:g}")
    if name == "rotation":
        lengths = np.linalg.norm(values[rows // 2 :: rows], axis=1)
        if np.abs(lengths - 1).max() > MAX_LENGTH_ERROR:
            raise ValueError("rotation: a quaternion that is not of length 1")
    if len(times) == 1:  # there is nothing to interpolate
        return Track(times, values[rows // 2 :][:1], "STEP", is_rotation=False)
    return Track(times, values, interpolation, is_rotation=name == "rotation")


def _in_world(
    moving: list[Moving], times: Float[np.ndarray, " F"]
) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, "F 4"]]:
    """Return positions and orientations wxyz, still Y up, of the first of `moving` nodes; each is a child of the next."""
    positions = np.zeros((len(times), 3))
    orientations = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(times), 4))
    for node in moving:
        rotation = np.roll(node["rotation"].at(times), 1, axis=1)
        scaled = node["scale"].at(times) * positions
        positions = node["translation"].at(times) + rotate(rotation, scaled)
        orientations = multiply(rotation, orientations)
    return positions, orientations
