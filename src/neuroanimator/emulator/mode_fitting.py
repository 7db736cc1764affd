"""Fitting shape modes: the directions in which the bodies of a dataset vary most, and their ranges along them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.pca import Basis, principal, reflection
from neuroanimator.emulator.shape_modes import LIMITS, ShapeModes, view_in_frame
from neuroanimator.state.segments import Lag
from neuroanimator.state.structure import Structure

HARDLY_EXCEEDED = 0.9995
"""Share of training states within the limits of the modes."""

MIN_SPREAD = 1e-9
"""Minimum standard deviation of a mode, which prevents division by zero."""


def fit_modes(
    structure: Structure,
    states: Float[np.ndarray, "B S"],
    position_modes: int,
    velocity_modes: int,
) -> ShapeModes:
    """Return the modes in which the bodies in `states` (B, S) vary most."""
    shapes, flow = shapes_and_flow(structure, states)
    reflect = None
    if structure.mirror is not None:
        reflect = reflection(structure.mirror)
    most = shapes.shape[1]
    positions = principal(shapes, min(position_modes, most), reflect)
    velocities = principal(flow, min(velocity_modes, most), reflect)
    return modes_along(structure, positions, velocities, states)


def shapes_and_flow(
    structure: Structure, states: Float[np.ndarray, "B S"]
) -> tuple[Float[np.ndarray, "B D"], Float[np.ndarray, "B D"]]:
    """Return the shapes of `states`, without the effect of their parameters on the shape at rest, and their flow."""
    cloud = structure.cloud
    assert cloud is not None
    body = view_in_frame(cloud, np.asarray(states, float))
    if not cloud.parameters:
        return body.shape, body.flow
    return body.shape - cloud.growth(np.asarray(states[:, -cloud.parameters :], float)), body.flow


def modes_along(
    structure: Structure, positions: Basis, velocities: Basis, states: Float[np.ndarray, "B S"]
) -> ShapeModes:
    """Return the modes in these directions, with the spread and limits of the bodies in `states` (B, S)."""
    assert structure.cloud is not None
    lags = [segment for segment in structure.segments if isinstance(segment, Lag)]
    time_constant = 0.0
    if lags:
        time_constant = lags[0].time_constant
    modes = ShapeModes(
        positions=as_jax(positions.directions),
        velocities=as_jax(velocities.directions),
        mean_position=as_jax(positions.mean),
        mean_velocity=as_jax(velocities.mean),
        spread=as_jax(np.ones(positions.directions.shape[1] + velocities.directions.shape[1])),
        limits=as_jax(np.ones(LIMITS.size)),
        cloud=structure.cloud,
        mirror=structure.mirror,
        odd_positions=positions.odd,
        odd_velocities=velocities.odd,
        muscles=sum(segment.size for segment in lags),
        time_constant=time_constant,
    )
    return _with_limits(modes, states)


def _with_limits(modes: ShapeModes, states: Float[np.ndarray, "B S"]) -> ShapeModes:
    """Return `modes` with the spread and limits of the bodies in `states` (B, S)."""
    latent = modes.encode(np.asarray(states, float))
    amounts = modes.layout.part(latent, "modes")
    spread = np.maximum(amounts.std(axis=0), MIN_SPREAD)
    limits = _limits_of(modes, latent, spread)
    return replace(
        modes,
        spread=as_jax(spread),
        limits=as_jax(limits),
    )


def with_wider_limits(modes: ShapeModes, latent: Float[np.ndarray, "B I"]) -> ShapeModes:
    """Return `modes` with limits that include the bodies in `latent` states (B, I), too."""
    own = _limits_of(modes, latent, np.asarray(modes.spread))
    return replace(modes, limits=as_jax(np.maximum(np.asarray(modes.limits), own)))


def _limits_of(
    modes: ShapeModes, latent: Float[np.ndarray, "B I"], spread: Float[np.ndarray, " K"]
) -> Float[np.ndarray, " 4"]:
    """Return the limits that the bodies in `latent` states (B, I) hardly exceed; those of modes in units of `spread`."""
    velocity = modes.layout.part(latent, "frame.velocity")
    angular_velocity = modes.layout.part(latent, "frame.angular_velocity")
    amounts = modes.layout.part(latent, "modes") / spread
    squares = modes.squares_of_limited(velocity, angular_velocity, amounts)
    return np.array([np.quantile(np.sqrt(square), HARDLY_EXCEEDED) for square in squares])
