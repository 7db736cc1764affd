"""The energy of a mass-spring body, by which its physics is held to laws."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array

from neuroanimator.physics.deformable.body import GRAVITY, Body
from neuroanimator.physics.deformable.mass_spring import BodyState


def energy(body: Body, state: BodyState) -> Array:
    """Return (...) kinetic and elastic energy, and that of weight [J]: in air, or in water without a surface."""
    positions, velocities, activations = state
    kinetic = jnp.einsum("n,nk...->...", body.masses, velocities**2) / 2
    first, second = body.springs.T
    lengths = jnp.sqrt(((positions[second] - positions[first]) ** 2).sum(axis=1))
    shortening = jnp.tensordot(body.muscles, activations, 1)
    stretch = lengths - (body.lengths * (1 - shortening).T).T
    elastic = jnp.einsum("p,p...->...", body.stiffness, stretch**2) / 2
    is_immersed = body.water is not None and body.water.surface is None
    weights = GRAVITY * body.masses * (1 - body.lift * is_immersed)
    return kinetic + elastic + jnp.einsum("n,n...->...", weights, positions[:, 2])
