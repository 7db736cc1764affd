"""Which evaluator a problem gets, and what makes its controls: generated C where there is a program for it, and JAX elsewhere."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from neuroanimator.backend import backend
from neuroanimator.control.descent.evaluator import Evaluator
from neuroanimator.control.descent.jax_evaluator import JaxEvaluator
from neuroanimator.control.descent.parametrisation import Parametrisation
from neuroanimator.control.descent.problem import Problem
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.jax_later import Array, filter_jit, jax, jnp


def controls_of(
    parametrisation: Parametrisation, zs: Float[np.ndarray, "K Z"]
) -> Float[np.ndarray, "K T C"]:
    """Return the controls each row of `zs` stands for, by the `backend`."""
    single = as_float32(zs)
    if backend() != "jax":
        from neuroanimator.control.descent.c_evaluator import controls_in_c

        controls = controls_in_c(parametrisation, single)
        if controls is not None:
            return controls.astype(float)
    return np.asarray(_controls_in_jax(parametrisation, single), float)


@filter_jit
def _controls_in_jax(
    parametrisation: Parametrisation, zs: Float[Array | np.ndarray, "K Z"]
) -> Float[Array, "K T C"]:
    return jax.vmap(parametrisation.controls)(jnp.asarray(zs))


def evaluator_of(problem: Problem) -> Evaluator:
    """Return what evaluates `problem`, by the `backend`."""
    if backend() != "jax":
        # With it comes the generator, which JAX does without.
        from neuroanimator.control.descent.c_evaluator import c_evaluator

        in_c = c_evaluator(problem)
        if in_c is not None:
            return in_c
    return JaxEvaluator(problem)
