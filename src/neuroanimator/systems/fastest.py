"""The true physics as fast as we have it: MuJoCo on every core, mass-spring bodies in C."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from neuroanimator.systems.cores import core_count
from neuroanimator.systems.deformable.body import Body
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.systems.deformable.native.compiled import CTwin, c_twin
from neuroanimator.systems.system import Runs, Scheme, System

LANES = 8
"""Bodies side by side in C: one AVX-512 register of float64."""


def play(
    system: System,
    starts: np.ndarray,
    controls: np.ndarray,
    dt: float,
    scheme: Scheme | None = None,
) -> Runs:
    """Return what `System.simulate` does from `starts` (B, S) under `controls` (B, T, C), sooner where possible.

    C and JAX agree to the last digits but a few (tests/systems/deformable/native/test_compiled.py).
    """
    scheme = scheme or system.truth
    if isinstance(system, DeformableSystem) and (
        twin := _twin(system.body, 1 if len(starts) == 1 else LANES)
    ):
        return _play_twin(system, twin, starts, system.check_controls(controls), dt, scheme)
    return system.simulate(starts, controls, dt, scheme=scheme, threads=core_count())


@lru_cache(maxsize=32)
def _twin(body: Body, lanes: int) -> CTwin | None:
    return c_twin(body, np.float64, lanes)


def _play_twin(
    system: DeformableSystem,
    twin: CTwin,
    starts: np.ndarray,
    controls: np.ndarray,
    dt: float,
    scheme: Scheme,
) -> Runs:
    states = np.empty((len(starts), controls.shape[1] + 1, system.state.size))
    states[:, 0] = starts
    for first in range(0, len(starts), twin.lanes):
        rows = np.arange(first, first + twin.lanes).clip(max=len(starts) - 1)
        last = lambda array: np.moveaxis(array[rows], 0, -1) if twin.lanes > 1 else array[rows[0]]  # noqa: B023, E731
        found = twin.play(
            last(starts), last(controls), scheme.integrator, scheme.dt, scheme.steps(dt)
        )
        states[rows, 1:] = np.moveaxis(found, -1, 0) if twin.lanes > 1 else found
    return Runs(states, system.is_sane(states))
