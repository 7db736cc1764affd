"""Unit quaternions wxyz, written once for NumPy and JAX arrays (the array API standard).

All functions take any leading axes.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.state.arrays import AnyArray

MIN_COSINE = 1e-3
"""Smallest cosine of half a rotation to divide by: no body turns that far in one super step, and the result stays finite."""

NO_ROTATION = (1.0, 0.0, 0.0, 0.0)
"""The quaternion of a body along the world's axes."""

Rows = tuple[tuple[AnyArray, AnyArray, AnyArray], ...]
"""The nine entries (...) of rotation matrices, row by row."""


def rotation_rows(quaternion: Float[AnyArray, "... 4"]) -> Rows:
    """Return the nine entries of the rotation matrix of a unit quaternion (..., 4), row by row."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def rotation_matrices(quaternions: Float[AnyArray, "... 4"]) -> Float[AnyArray, "... 3 3"]:
    """Return the matrices (..., 3, 3) of unit quaternions (..., 4)."""
    xp = quaternions.__array_namespace__()
    return xp.stack([xp.stack(row, axis=-1) for row in rotation_rows(quaternions)], axis=-2)


def quaternions_of(matrices: Float[AnyArray, "... 3 3"]) -> Float[AnyArray, "... 4"]:
    """Return the unit quaternions q (..., 4) of rotation matrices (..., 3, 3): the largest row of 4 q qᵀ (Shepperd 1978)."""
    xp = matrices.__array_namespace__()
    rows = fit_of_quaternions(matrices.mT) + xp.eye(4, dtype=matrices.dtype)
    largest = xp.argmax(xp.linalg.diagonal(rows), axis=-1)
    quaternions = xp.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :]
    return of_unit_length(quaternions)


def fit_of_quaternions(products: Float[AnyArray, "... 3 3"]) -> Float[AnyArray, "... 4 4"]:
    """Return the symmetric matrices N (..., 4, 4) for which qᵀ N q tells how well q turns vectors a into b (Horn 1987).

    `products` are the sums of a bᵀ. The best q is the leading eigenvector; for the axes of a rotation N is 4 q qᵀ - 1.
    """
    xp = products.__array_namespace__()
    xx, xy, xz = (products[..., 0, i] for i in range(3))
    yx, yy, yz = (products[..., 1, i] for i in range(3))
    zx, zy, zz = (products[..., 2, i] for i in range(3))
    rows = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def turned(rows: Rows, vectors: Float[AnyArray, "... 3"]) -> Float[AnyArray, "... 3"]:
    """Return R·`vectors` (..., 3) for the entries of R, row by row."""
    xp = vectors.__array_namespace__()
    return xp.stack([sum(row[i] * vectors[..., i] for i in range(3)) for row in rows], axis=-1)


def transposed(rows: Rows) -> Rows:
    """Return the entries of the inverse rotation."""
    return tuple(zip(*rows, strict=True))


def rotate(
    quaternion: Float[AnyArray, "... 4"], vector: Float[AnyArray, "... 3"]
) -> Float[AnyArray, "... 3"]:
    """Return R·vector (..., 3): from the body's frame to the world's."""
    return turned(rotation_rows(quaternion), vector)


def rotate_back(
    quaternion: Float[AnyArray, "... 4"], vector: Float[AnyArray, "... 3"]
) -> Float[AnyArray, "... 3"]:
    """Return Rᵀ·vector (..., 3): from the world's frame to the body's."""
    return turned(transposed(rotation_rows(quaternion)), vector)


def to_world_axes(
    quaternion: Float[AnyArray, "... 4"], vectors: Float[AnyArray, "... N 3"]
) -> Float[AnyArray, "... N 3"]:
    """Return `vectors` (..., N, 3), given along the axes of bodies turned by `quaternion` (..., 4), in the world."""
    return rotate(quaternion[..., None, :], vectors)


def to_body_axes(
    quaternion: Float[AnyArray, "... 4"], vectors: Float[AnyArray, "... N 3"]
) -> Float[AnyArray, "... N 3"]:
    """Return `vectors` (..., N, 3) along the axes of bodies turned by `quaternion` (..., 4)."""
    return rotate_back(quaternion[..., None, :], vectors)


def upward(quaternion: Float[AnyArray, "... 4"]) -> Float[AnyArray, "... 3"]:
    """Return the world's Z axis in the body's frame (..., 3): 'up', at any heading."""
    return quaternion.__array_namespace__().stack(rotation_rows(quaternion)[2], axis=-1)


def multiply(
    left: Float[AnyArray, "... 4"], right: Float[AnyArray, "... 4"]
) -> Float[AnyArray, "... 4"]:
    """Return the quaternion product (..., 4): `right` acts first."""
    a, b, c, d = (left[..., i] for i in range(4))
    w, x, y, z = (right[..., i] for i in range(4))
    parts = [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]
    return left.__array_namespace__().stack(parts, axis=-1)


def conjugate(quaternion: Float[AnyArray, "... 4"]) -> Float[AnyArray, "... 4"]:
    """Return the inverse of a unit quaternion (..., 4)."""
    xp = quaternion.__array_namespace__()
    return xp.concat([quaternion[..., :1], -quaternion[..., 1:]], axis=-1)


def rotated_by(
    quaternion: Float[AnyArray, "... 4"], rotation: Float[AnyArray, "... 3"]
) -> Float[AnyArray, "... 4"]:
    """Return `quaternion` (..., 4) turned by the Rodrigues vector `rotation` (..., 3), exactly of unit length.

    A Rodrigues vector is 2·tan(angle/2) along the axis, in the body's frame: equal to a small rotation vector to second
    order, without a series or branch.
    """
    xp = rotation.__array_namespace__()
    half = rotation / 2
    unscaled = xp.concat([xp.ones_like(half[..., :1]), half], axis=-1)
    following = multiply(quaternion, unscaled)
    return of_unit_length(following)


def of_unit_length(vectors: Float[AnyArray, "... N"]) -> Float[AnyArray, "... N"]:
    """Return `vectors` over their lengths."""
    xp = vectors.__array_namespace__()
    return vectors / xp.sqrt(xp.sum(vectors * vectors, axis=-1, keepdims=True))


def rotation_between(
    before: Float[AnyArray, "... 4"], after: Float[AnyArray, "... 4"]
) -> Float[AnyArray, "... 3"]:
    """Return the Rodrigues vector (..., 3) that turns `before` into `after`, in `before`'s frame.

    A turn of more than half a revolution counts as the shorter way round.
    """
    relative = multiply(conjugate(before), after)
    xp = relative.__array_namespace__()
    w = relative[..., :1]
    return 2 * relative[..., 1:] / xp.where(xp.abs(w) > MIN_COSINE, w, MIN_COSINE)


def wrapped(angle: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """Return angles [rad] without whole turns, from -pi to pi."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def cross(
    left: Float[AnyArray, "... 3"], right: Float[AnyArray, "... 3"]
) -> Float[AnyArray, "... 3"]:
    """Return the vector product (..., 3)."""
    a, b, c = (left[..., i] for i in range(3))
    x, y, z = (right[..., i] for i in range(3))
    xp = left.__array_namespace__()
    return xp.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def rotate_in_plane(
    angle: Float[AnyArray, "... 1"], vector: Float[AnyArray, "... 2"]
) -> Float[AnyArray, "... 2"]:
    """Return `vector` (..., 2) turned by `angle` (..., 1) [rad]."""
    xp = vector.__array_namespace__()
    cosine = xp.cos(angle[..., 0])
    sine = xp.sin(angle[..., 0])
    x = vector[..., 0]
    y = vector[..., 1]
    return xp.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


def two_axes(quaternion: Float[AnyArray, "... 4"]) -> Float[AnyArray, "... 6"]:
    """Return two columns of the rotation (..., 6): all of it, without the quaternion's double sign."""
    rows = rotation_rows(quaternion)
    xp = quaternion.__array_namespace__()
    return xp.stack([rows[i][j] for j in range(2) for i in range(3)], axis=-1)


def heading_of(quaternion: Float[AnyArray, "... 4"]) -> Float[AnyArray, " ..."]:
    """Return the angle (...) between the world's X axis and the body's, seen from above [rad]."""
    rows = rotation_rows(quaternion)
    return quaternion.__array_namespace__().atan2(rows[1][0], rows[0][0])


def facing(heading: Float[AnyArray, " ..."]) -> Float[AnyArray, "... 4"]:
    """Return the quaternion (..., 4) that turns by `heading` (...) [rad] about Z."""
    xp = heading.__array_namespace__()
    zero = xp.zeros_like(heading)
    return xp.stack([xp.cos(heading / 2), zero, zero, xp.sin(heading / 2)], axis=-1)


def continuous(
    quaternions: Float[np.ndarray, "T *B 4"], before: Float[np.ndarray, "1 *B 4"] | None = None
) -> Float[np.ndarray, "T *B 4"]:
    """Return the quaternions with signs flipped such that each is nearest to the one before, the first to `before`."""
    if before is None:
        before = quaternions[:1]
    earlier = np.concatenate([before, quaternions[:-1]])
    dots = (earlier * quaternions).sum(axis=-1, keepdims=True)
    return quaternions * np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
