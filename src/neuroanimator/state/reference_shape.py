"""Position and rotation of a cloud of mass points: the frame of a deformable body's shape.

Written for NumPy and JAX; mass points are (..., N, 3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from neuroanimator.files.numbers import listed, numbers
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.rotation import cross, fit_of_quaternions, to_body_axes, to_world_axes

Point = tuple[float, float, float]

MAX_DISTANCE = 1e6
"""Largest coordinate of a mass point in a file [m]."""

SHARES_OFF = 1e-6
"""Tolerance of the sum of mass shares in a file, which should be 1: they are rounded."""


@dataclass(frozen=True)
class Cloud:
    """Mass points at rest, and their masses."""

    positions: tuple[Point, ...]
    """Positions at rest (N, 3) [m], from their centroid."""
    masses: tuple[float, ...]
    """Masses (N,), as shares of the whole."""
    nominal: tuple[float, ...] = ()
    """Parameters (Q,) of the body of this shape, the last entries of a state; empty for a single body."""
    slopes: tuple[tuple[Point, ...], ...] = ()
    """Change of `positions` per unit of each parameter (Q, N, 3)."""

    @classmethod
    def of(cls, positions: np.ndarray, masses: np.ndarray) -> Cloud:
        """Return the cloud of `positions` (N, 3) [m] and `masses` (N,) [kg]."""
        shares = masses / masses.sum()
        centred = positions - shares @ positions
        return cls(_points(centred), tuple(float(m) for m in shares))

    def of_family(
        self, nominal: Float[np.ndarray, " Q"], slopes: Float[np.ndarray, "Q N 3"]
    ) -> Cloud:
        """Return the cloud of a family, whose shape at rest changes by `slopes` [m] per unit of each parameter."""
        centred = slopes - self.centroid(slopes)[:, None]
        return replace(
            self,
            nominal=tuple(float(value) for value in nominal),
            slopes=tuple(_points(slope) for slope in centred),
        )

    def to_json(self) -> list[Any]:
        """Return plain lists: positions and mass shares; for a family also nominal parameters and slopes."""
        row: list[Any] = [list(self.positions), list(self.masses)]
        if self.nominal:
            row += [list(self.nominal), [list(slope) for slope in self.slopes]]
        return row

    @classmethod
    def from_json(cls, row: Any, what: str) -> Cloud:
        """Return the cloud `to_json` wrote; ValueError unless shares are above 0 and add up to 1."""
        positions, masses, *family = row
        shares = numbers(masses, f"{what}: masses", most=1)
        if not shares or min(shares) <= 0 or abs(sum(shares) - 1) > SHARES_OFF:
            raise ValueError(f"{what}: wanted masses as shares of the whole, each above 0")
        points = listed(positions, f"{what}: places", _point_from_json, len(shares))
        if not family:
            return cls(points, shares)
        nominal, slopes = family
        values = numbers(nominal, f"{what}: parameters")

        def slope_from_json(rows: Any, name: str) -> tuple[Point, ...]:
            return listed(rows, name, _point_from_json, len(shares))

        by_parameter = listed(slopes, f"{what}: slopes", slope_from_json, len(values))
        return cls(points, shares, values, by_parameter)

    @property
    def count(self) -> int:
        """Number of mass points."""
        return len(self.masses)

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return len(self.nominal)

    def growth(self, parameters: Float[AnyArray, "... Q"]) -> Float[AnyArray, "... D"]:
        """Return the displacements of mass points at rest in a body with these parameters [m]; D = 3 N."""
        xp = parameters.__array_namespace__()
        slopes = xp.asarray(self.slopes, dtype=parameters.dtype).reshape(
            self.parameters, 3 * self.count
        )
        return (parameters - xp.asarray(self.nominal, dtype=parameters.dtype)) @ slopes

    def reshaped(
        self, state: Float[np.ndarray, " S"], parameters: Float[np.ndarray, " Q"]
    ) -> Float[np.ndarray, " S"]:
        """Return the `state` of the body with other parameters: it is reshaped along its own axes, about its centroid."""
        changed = np.array(state, float)
        points = points_of(changed[: 3 * self.count])
        before = state[len(state) - self.parameters :]
        growth = points_of(self.growth(np.asarray(parameters, float)) - self.growth(before))
        points += to_world_axes(self.orientation(points), growth)
        changed[len(state) - self.parameters :] = parameters
        return changed

    def centroid(self, points: Float[AnyArray, "... N 3"]) -> Float[AnyArray, "... 3"]:
        """Return the mass-weighted mean (..., 3) of `points` (..., N, 3): positions or velocities."""
        xp = points.__array_namespace__()
        shares = xp.asarray(self.masses, dtype=points.dtype)[:, None]
        return xp.sum(shares * points, axis=-2)

    def own_frame(
        self, positions: Float[AnyArray, "... N 3"]
    ) -> tuple[Float[AnyArray, "... 3"], Float[AnyArray, "... 4"], Float[AnyArray, "... N 3"]]:
        """Return the centroid (..., 3), the `orientation` (..., 4), and `positions` (..., N, 3) from it, along its axes."""
        centre = self.centroid(positions)
        centred = positions - centre[..., None, :]
        orientation = self._closest_orientation(centred)
        return centre, orientation, to_body_axes(orientation, centred)

    def orientation(self, positions: Float[AnyArray, "... N 3"]) -> Float[AnyArray, "... 4"]:
        """Return the unit quaternion (..., 4) that turns the cloud at rest closest to `positions` (..., N, 3).

        Closest in mass-weighted squares: the frame that wobbles least with the shape (Eckart 1935), found as the leading
        eigenvector of a 4 x 4 matrix (Horn 1987). Its first entry is not negative.
        """
        return self._closest_orientation(positions - self.centroid(positions)[..., None, :])

    def _closest_orientation(self, centred: Float[AnyArray, "... N 3"]) -> Float[AnyArray, "... 4"]:
        xp = centred.__array_namespace__()
        rest = xp.asarray(self.positions, dtype=centred.dtype)
        shares = xp.asarray(self.masses, dtype=centred.dtype)
        products = (rest * shares[:, None]).mT @ centred
        return closest_quaternion(products)

    def angular_velocity(
        self, shape: Float[AnyArray, "... N 3"], velocities: Float[AnyArray, "... N 3"]
    ) -> Float[AnyArray, "... 3"]:
        """Return the angular velocity (..., 3) [rad/s] that carries the cloud's angular momentum.

        `shape` and `velocities` (..., N, 3) are positions from the centroid and velocities, along the body's axes.
        """
        xp = shape.__array_namespace__()
        shares = xp.asarray(self.masses, dtype=shape.dtype)[:, None]
        momentum = xp.sum(shares * cross(shape, velocities), axis=-2)
        moments = (shares * shape).mT @ shape
        trace = moments[..., 0, 0] + moments[..., 1, 1] + moments[..., 2, 2]
        inertia = trace[..., None, None] * xp.eye(3, dtype=shape.dtype) - moments
        return _solve(inertia, momentum)


def closest_quaternion(products: Float[AnyArray, "... 3 3"]) -> Float[AnyArray, "... 4"]:
    """Return the unit quaternion (..., 4) that turns vectors a closest to others b, whose sums of a bᵀ are the `products`.

    Its first entry is not negative.
    """
    quaternion = _largest_eigenvector(fit_of_quaternions(products))
    return quaternion * products.__array_namespace__().where(quaternion[..., :1] < 0, -1.0, 1.0)


def _largest_eigenvector(matrix: Float[AnyArray, "... 4 4"]) -> Float[AnyArray, "... 4"]:
    """Return the eigenvector of the largest eigenvalue of a symmetric matrix."""
    if isinstance(matrix, np.ndarray):
        return np.linalg.eigh(matrix)[1][..., -1]
    return _largest_eigenvector_in_jax(matrix)


@jax.custom_jvp
def _largest_eigenvector_in_jax(matrix: Float[AnyArray, "... 4 4"]) -> Float[AnyArray, "... 4"]:
    """Return the same for a JAX array, with a custom derivative.

    JAX' derivative of all eigenvectors divides by the differences of all eigenvalues, and the smaller ones of a cube are
    equal. The derivative of one eigenvector v needs only its own differences: to first order it turns towards the
    others by (u · dM v) / (λ - μ) (Magnus 1985).
    """
    return jnp.linalg.eigh(matrix)[1][..., -1]


@_largest_eigenvector_in_jax.defjvp
def _derivative(primals: tuple[AnyArray], tangents: tuple[AnyArray]) -> tuple[AnyArray, AnyArray]:
    values, vectors = jnp.linalg.eigh(primals[0])
    largest = vectors[..., -1]
    others = vectors[..., :-1]
    gaps = values[..., -1:] - values[..., :-1]
    gaps = jnp.where(gaps > 0, gaps, 1.0)
    turns = (others.mT @ (tangents[0] @ largest[..., None]))[..., 0] / gaps
    return largest, (others @ turns[..., None])[..., 0]


def _solve(
    matrix: Float[AnyArray, "... 3 3"], right: Float[AnyArray, "... 3"]
) -> Float[AnyArray, "... 3"]:
    """Return the x with `matrix` x = `right`, by Cramer's rule, without pivoting or loops to compile."""
    xp = matrix.__array_namespace__()
    first = matrix[..., :, 0]
    second = matrix[..., :, 1]
    third = matrix[..., :, 2]
    normals = xp.stack([cross(second, third), cross(third, first), cross(first, second)], axis=-2)
    volume = xp.sum(first * normals[..., 0, :], axis=-1)
    return xp.sum(normals * right[..., None, :], axis=-1) / volume[..., None]


def _points(rows: Float[np.ndarray, "N 3"]) -> tuple[Point, ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)


def _point_from_json(row: Any, what: str) -> Point:
    x, y, z = numbers(row, what, 3, MAX_DISTANCE)
    return x, y, z


def points_of(flat: Float[AnyArray, "... D"]) -> Float[AnyArray, "... N 3"]:
    """Return the mass points (..., N, 3) of `flat` (..., 3N)."""
    return flat.reshape(*flat.shape[:-1], -1, 3)


def flat_of(points: Float[AnyArray, "... N 3"]) -> Float[AnyArray, "... D"]:
    """Return mass points (..., N, 3) as flat vectors (..., 3N)."""
    return points.reshape(*points.shape[:-2], -1)
