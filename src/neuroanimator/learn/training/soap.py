"""SOAP: Adam in the eigenbases of the gradient's Kronecker factors, after Vyas et al. (2024, arXiv 2409.11321)."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int

DECAY = 0.95
"""Decay rate of the mean gradient, of its square and of the factors (β₁, β₂ and Shampoo's β)."""

REFRESH = 10
"""Number of updates between two refreshes of the bases, which turn slowly."""

EPSILON = 1e-8
"""Added to root mean square gradients, so that numbers without any are not divided by zero."""


class Eigenbasis(NamedTuple):
    """A basis for one side of a matrix."""

    factor: Float[Array, "K K"]
    """Kronecker factor: mean product of the gradient with itself."""
    vectors: Float[Array, "K K"]
    """Approximate eigenvectors of the factor, in columns."""

    @classmethod
    def fresh(cls, size: int) -> Eigenbasis:
        return cls(jnp.zeros((size, size)), jnp.eye(size))

    def seen(self, product: Float[Array, "K K"]) -> Eigenbasis:
        return self._replace(factor=_mean(self.factor, product))

    def refreshed(self) -> Eigenbasis:
        """Return the basis after one power iteration."""
        return self._replace(vectors=jnp.linalg.qr(self.factor @ self.vectors)[0])


class GradientMoments(NamedTuple):
    """Moments of the gradient of one array of weights, as seen in the bases."""

    mean: Array
    square: Array
    bases: tuple[Eigenbasis, ...]
    """Those of rows and columns. A vector has none, and so Adam's updates."""

    @classmethod
    def fresh(cls, weights: Array) -> GradientMoments:
        # Without a mirror a network has no even inputs: a matrix without rows.
        is_matrix = weights.ndim == 2 and weights.size > 0
        bases = tuple(map(Eigenbasis.fresh, weights.shape)) if is_matrix else ()
        return cls(jnp.zeros_like(weights), jnp.zeros_like(weights), bases)

    def refreshed(self) -> GradientMoments:
        """Return the moments in refreshed bases. Mean squares stay as they are, since bases turn slowly."""
        new = self._replace(bases=tuple(basis.refreshed() for basis in self.bases))
        return new._replace(mean=new.within(self.without(self.mean)))

    def seen(self, gradient: Array) -> GradientMoments:
        """Return the moments with another `gradient`."""
        within = self.within(gradient)
        bases = self.bases
        if bases:
            rows, columns = bases
            bases = rows.seen(gradient @ gradient.T), columns.seen(gradient.T @ gradient)
        return GradientMoments(_mean(self.mean, within), _mean(self.square, within**2), bases)

    def step(self, correction: Float[Array, ""]) -> Array:
        """Return the update; `correction` is the total weight of the gradients seen."""
        scale = jnp.sqrt(self.square / correction) + EPSILON
        return self.without(self.mean / correction / scale)

    def within(self, matrix: Array) -> Array:
        """Return `matrix` as seen in the bases."""
        if not self.bases:
            return matrix
        rows, columns = self.bases
        return rows.vectors.T @ matrix @ columns.vectors

    def without(self, matrix: Array) -> Array:
        """Return a `matrix` seen in the bases as it is."""
        if not self.bases:
            return matrix
        rows, columns = self.bases
        return rows.vectors @ matrix @ columns.vectors.T


class SoapState(NamedTuple):
    """State of `scale_by_soap`."""

    seen: Int[Array, ""]
    """Number of gradients seen."""
    moments: list[GradientMoments]
    """Those of each array of weights."""


def scale_by_soap() -> optax.GradientTransformation:
    """Return the transformation of gradients into SOAP's updates."""
    return optax.GradientTransformation(_fresh, _update)


def _fresh(params: Any) -> SoapState:
    return SoapState(
        jnp.zeros((), jnp.int32), [GradientMoments.fresh(w) for w in jax.tree.leaves(params)]
    )


def _update(updates: Any, state: Any, params: Any = None) -> tuple[Any, SoapState]:
    is_due = state.seen % REFRESH == 0
    moments = jax.lax.cond(is_due, _refreshed, lambda moments: moments, state.moments)
    count = state.seen + 1
    gradients, tree = jax.tree.flatten(updates)
    moments = [known.seen(gradient) for known, gradient in zip(moments, gradients, strict=True)]
    correction = 1 - DECAY**count
    steps = [known.step(correction) for known in moments]
    return tree.unflatten(steps), SoapState(count, moments)


def _refreshed(moments: list[GradientMoments]) -> list[GradientMoments]:
    return [known.refreshed() for known in moments]


def _mean(old: Array, new: Array) -> Array:
    """Return the exponential moving average."""
    return DECAY * old + (1 - DECAY) * new
