"""Evaluators: J of motions, its derivatives and the motions themselves, as NumPy arrays, by generated C or by JAX."""

from __future__ import annotations

import abc
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class QuadraticModel(NamedTuple):
    """J near some z: cost + slope · dz + dz · curvature · dz / 2, with the Gauss-Newton curvature."""

    curvature: Float[np.ndarray, "Z Z"]
    """JᵀJ of the residuals' Jacobian; costs that are not sums of squares add nothing to it.

    In float32, as computed: in float64 LAPACK would solve with it on several threads, which on a busy machine wait for
    each other a hundred times as long as they compute.
    """
    slope: Float[np.ndarray, " Z"]
    """dJ/dz"""
    cost: float
    """J at z."""


class EmulatedMotion(NamedTuple):
    """The emulator's motion under the controls of one z."""

    states: Float[np.ndarray, "T+1 S"]
    controls: Float[np.ndarray, "T C"]


class Evaluator(abc.ABC):
    """J of motions from one start on the emulator, and its derivatives, for several z in parallel.

    Inputs and outputs are float64, unless stated otherwise; the emulator computes in float32.
    """

    compile_seconds: float = 0.0
    """Time taken by compilation [s]."""

    @abc.abstractmethod
    def costs(self, zs: Float[np.ndarray, "K Z"]) -> Float[np.ndarray, " K"]:
        """Return J of each z; not finite if the emulator or the objective diverges."""

    @abc.abstractmethod
    def gradients(
        self, zs: Float[np.ndarray, "K Z"]
    ) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, "K Z"]]:
        """Return (J of each z, dJ/dz)."""

    @abc.abstractmethod
    def quadratic_models(self, zs: Float[np.ndarray, "K Z"]) -> list[QuadraticModel]:
        """Return the quadratic model of J near each z."""

    @abc.abstractmethod
    def motion(self, z: Float[np.ndarray, " Z"]) -> EmulatedMotion:
        """Return the emulated motion under the controls of `z`."""

    @abc.abstractmethod
    def at(self, start: Float[np.ndarray, " S"]) -> Evaluator:
        """Return the evaluator of motions from another start; nothing is recompiled."""
