"""Where states put bones, in NumPy alone. Arrays of states are (T, S); Z up, metres, quaternions wxyz, as Blender has them."""

import numpy as np


def multiply(a, b):
    """Return the products (..., 4) of quaternions."""
    w, x, y, z = np.moveaxis(a, -1, 0)
    v, i, j, k = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            w * v - x * i - y * j - z * k,
            w * i + x * v + y * k - z * j,
            w * j - x * k + y * v + z * i,
            w * k + x * j - y * i + z * v,
        ],
        axis=-1,
    )


def rotate(quaternions, vectors):
    """Return `vectors` (..., 3) turned by `quaternions` (..., 4)."""
    w, axis = quaternions[..., :1], quaternions[..., 1:]
    across = 2 * np.cross(axis, vectors)
    return vectors + w * across + np.cross(axis, across)


def unit(vectors):
    """Return `vectors` at length one."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def local_poses(bones, states):
    """Return for each bone its positions (T, 3) and orientations (T, 4) in its parent's frame."""
    return [
        _bound(bone, states) if bone.get("binding") else _jointed(bone, states) for bone in bones
    ]


def _jointed(bone, states):
    position = np.broadcast_to(np.array(bone["offset"], float), (len(states), 3))
    orientation = np.broadcast_to(np.array(bone["orientation"], float), (len(states), 4))
    for joint in bone["joints"]:
        entry, kind = joint["entry"], joint["kind"]
        if kind == "free":
            position = states[:, entry : entry + 3]
            orientation = unit(states[:, entry + 3 : entry + 7])
        elif kind == "slide":
            distance = states[:, entry, None] - joint["reference"]
            position = position + rotate(orientation, distance * np.array(joint["axis"]))
        else:
            anchor = np.broadcast_to(np.array(joint["anchor"], float), (len(states), 3))
            fixed = position + rotate(orientation, anchor)
            orientation = multiply(orientation, _turn(joint, states))
            position = fixed - rotate(orientation, anchor)
    return position, orientation


def _turn(joint, states):
    entry = joint["entry"]
    if joint["kind"] == "ball":
        return unit(states[:, entry : entry + 4])
    half = (states[:, entry, None] - joint["reference"]) / 2
    return np.concatenate([np.cos(half), np.sin(half) * np.array(joint["axis"])], axis=-1)


def _bound(bone, states):
    binding = bone["binding"]
    position = weighted(binding["position"], states)
    if not binding["forward"]:
        return position, np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(states), 4))
    x = unit(weighted(binding["forward"], states))
    up = weighted(binding["up"], states)
    z = unit(up - (up * x).sum(axis=-1, keepdims=True) * x)
    return position, _quaternions(np.stack([x, np.cross(z, x), z], axis=-1))


def weighted(rows, states):
    """Return sums (T, 3) of weight times the three numbers from an entry on, over `rows` of (entry, weight)."""
    return sum(weight * states[:, entry : entry + 3] for entry, weight in rows)


def _quaternions(axes):
    """Return the quaternions of rotation matrices (T, 3, 3), by the largest of the four numbers."""
    m = axes
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    squares = np.stack([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz], -1)
    a, b, c = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    d, e, f = m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2]
    s0, s1, s2, s3 = squares.T
    rows = np.stack(
        [
            np.stack([s0, a, b, c], -1),
            np.stack([a, s1, d, e], -1),
            np.stack([b, d, s2, f], -1),
            np.stack([c, e, f, s3], -1),
        ],
        axis=1,
    )
    return unit(rows[np.arange(len(m)), squares.argmax(axis=-1)])


def continuous(quaternions):
    """Return quaternions (T, 4), each with the sign that is nearest to the one before."""
    dots = (quaternions[1:] * quaternions[:-1]).sum(axis=-1, keepdims=True)
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.concatenate([quaternions[:1], quaternions[1:] * signs])


def between(states, dt, times, rates, orientations):
    """Return the states (F, S) at `times` [s], on Hermite's cubics between `states` (T, S), which lie `dt` [s] apart."""
    states = np.array(states, float)
    for turn, _ in orientations:
        states[:, turn : turn + 4] = continuous(states[:, turn : turn + 4])
    place = np.clip(np.asarray(times) / dt, 0, len(states) - 1)
    index = np.minimum(place.astype(int), len(states) - 2)
    share = (place - index)[:, None]
    before, after = states[index], states[index + 1]
    found = before * (1 - share) + after * share
    for turn, spin in orientations:
        q = states[:, turn : turn + 4]
        imaginary = states[:, spin : spin + 3]
        slope = multiply(q, np.concatenate([np.zeros((len(q), 1)), imaginary], axis=1)) / 2 * dt
        cubic = _cubic(share, q[index], q[index + 1], slope[index], slope[index + 1])
        found[:, turn : turn + 4] = unit(cubic)
    if len(rates):
        p, v = np.array(rates).T
        found[:, p] = _cubic(share, before[:, p], after[:, p], before[:, v] * dt, after[:, v] * dt)
    return found


def _cubic(s, p0, p1, v0, v1):
    rising = (3 - 2 * s) * s * s
    return (1 - rising) * p0 + rising * p1 + s * (1 - s) ** 2 * v0 - s * s * (1 - s) * v1


def pose_of(root, state):
    """Return position, forward, up (3,) and roll [rad] of the whole body; None where nothing moves freely."""
    if root is None:
        return None
    states = np.asarray(state, float)[None]
    if root["kind"] == "free":
        position = states[:, root["position"] : root["position"] + 3]
        turn = unit(states[:, root["orientation"] : root["orientation"] + 4])
        forward = rotate(turn, np.array([[1.0, 0.0, 0.0]]))
        up = rotate(turn, np.array([[0.0, 0.0, 1.0]]))
    else:
        position = weighted(root["position"], states)
        # Weights of a direction add up to nothing but rounding: about the middle they are exact.
        forward = unit(weighted(root["forward"], states) - _sum(root["forward"]) * position)
        up = unit(weighted(root["up"], states) - _sum(root["up"]) * position)
    left = np.cross(up, forward)
    above = np.cross(forward, left)
    return position[0], forward[0], up[0], float(np.arctan2(left[0, 2], above[0, 2]))


def _sum(rows):
    return sum(weight for _, weight in rows)
