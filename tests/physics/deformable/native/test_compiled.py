"""The C twin is the same physics as the JAX one, or says that it cannot be had."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from neuroanimator.codegen import compiler
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.physics import load_system
from neuroanimator.physics.deformable.body import Body, Ground
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.deformable.mass_spring import BodyState, trajectory
from neuroanimator.physics.deformable.native import source as source
from neuroanimator.physics.deformable.native.compiled import INTEGRATORS, SINGLE_LANES, c_twin
from neuroanimator.physics.deformable.native.source import fill_in
from neuroanimator.physics.water import Water

STEPS = 100
needs_compiler = pytest.mark.skipif(
    find_compiler() is None, reason="no C compiler: see the test of its absence"
)


def driven(name: str, count: int = SINGLE_LANES) -> tuple[DeformableSystem, np.ndarray, np.ndarray]:
    """Return a system, random starts (B, S) and controls (B, C)."""
    system, rng = load_system(name), np.random.default_rng(0)
    assert isinstance(system, DeformableSystem)
    return (
        system,
        system.sample_starts(rng, count),
        rng.uniform(-1, 1, (count, system.control.size)),
    )


def jax_ends(
    body: Body, starts: np.ndarray, controls: np.ndarray, integrator: str, dt: float
) -> np.ndarray:
    """Return states (B, S) `STEPS` steps of the JAX physics later, in float64."""
    size = 3 * len(body.masses)
    parts = starts[:, :size], starts[:, size : 2 * size]
    with jax.enable_x64(True):
        positions, velocities = (
            np.moveaxis(part.reshape(len(starts), -1, 3), 0, -1) for part in parts
        )
        motion = BodyState(
            *(jax.numpy.asarray(each) for each in (positions, velocities, starts[:, 2 * size :].T))
        )
        found = trajectory(body, integrator, dt, STEPS, motion, jax.numpy.asarray(controls.T)[None])
        return np.concatenate([np.asarray(each)[0].reshape(-1, len(starts)) for each in found]).T


@needs_compiler
@pytest.mark.parametrize("name", ["fish", pytest.param("dolphin", marks=pytest.mark.endurance)])
def test_c_and_jax_agree_after_a_hundred_steps(name: str):
    system, starts, controls = driven(name)
    for integrator in INTEGRATORS:
        truth = jax_ends(system.body, starts, controls, integrator, system.physics_dt)
        for lanes in (1, SINGLE_LANES):
            twin = c_twin(system.body, np.float64, lanes)
            assert twin is not None
            found = twin.advance(starts, controls, integrator, system.physics_dt, STEPS)
            np.testing.assert_allclose(
                found, truth, atol=1e-9, rtol=1e-9, err_msg=f"{integrator}, {lanes} lanes"
            )


@needs_compiler
def test_ground_drag_weight_pushes_and_triangles_agree_too():
    body = dropped_body()
    rng = np.random.default_rng(1)
    positions = body.positions + rng.normal(size=(SINGLE_LANES, *body.positions.shape)) * 0.02
    velocities = rng.normal(size=positions.shape)
    starts = np.concatenate(
        [each.reshape(SINGLE_LANES, -1) for each in (positions, velocities)], axis=1
    )
    controls = rng.uniform(-1, 1, (SINGLE_LANES, 3))
    for integrator in INTEGRATORS:
        truth = jax_ends(body, starts, controls, integrator, 5e-4)
        twin = c_twin(body, np.float64)
        assert twin is not None
        np.testing.assert_allclose(
            twin.advance(starts, controls, integrator, 5e-4, STEPS), truth, atol=1e-9
        )


def dropped_body() -> Body:
    """A tetrahedron half under water, about to touch the ground."""
    return Body(
        names=("a", "b", "c", "d"),
        positions=np.array([[0, 0, 0.01], [0.2, 0, 0.01], [0, 0.2, 0.01], [0, 0, 0.2]]),
        masses=np.array([0.1, 0.2, 0.1, 0.1]),
        springs=np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]),
        stiffness=np.full(6, 50.0),
        damping=np.full(6, 0.2),
        muscles=np.zeros((6, 0)),
        external_forces=np.eye(3) * 2.0,
        faces=np.array([[0, 2, 1, 0], [0, 1, 3, 0], [0, 3, 2, 0], [1, 2, 3, 1]]),
        water=Water(face_drag=20.0, drag=0.5, buoyancy=1.3, surface=0.1, depth=0.05),
        ground=Ground(stiffness=500.0, damping=0.5, friction=0.6, slip=0.05),
    )


@needs_compiler
def test_single_precision_stays_close():
    system, starts, controls = driven("fish")
    moved = np.abs(starts).max()
    for integrator in INTEGRATORS:
        twin, exact = c_twin(system.body), c_twin(system.body, np.float64)
        assert twin is not None
        assert exact is not None
        truth = exact.advance(starts, controls, integrator, system.physics_dt, STEPS)
        off = twin.advance(starts, controls, integrator, system.physics_dt, STEPS) - truth
        assert 0 < np.abs(off).max() < 1e-3 * moved


@needs_compiler
def test_played_controls_are_the_same_as_one_stretch_after_another():
    system, starts, _ = driven("dolphin", 1)
    twin = c_twin(system.body, np.float64)
    assert twin is not None
    controls = np.random.default_rng(2).uniform(-1, 1, (3, system.control.size))
    states = twin.play(starts[0], controls, "symplectic", system.physics_dt, 10)
    state = starts
    for held, reached in zip(controls, states, strict=True):
        state = twin.advance(state, held[None], "symplectic", system.physics_dt, 10)
        np.testing.assert_array_equal(state[0], reached)


@needs_compiler
def test_loops_over_tables_are_the_same_program(monkeypatch: pytest.MonkeyPatch):
    system, starts, controls = driven("fish", 2)
    written_out = c_twin(system.body, np.float64)
    monkeypatch.setattr(source, "MAX_STATEMENTS", 10)
    looped = c_twin(system.body, np.float64)
    assert written_out is not None
    assert looped is not None
    arguments = (starts, controls, "semi-implicit", system.physics_dt, STEPS)
    np.testing.assert_allclose(
        looped.advance(*arguments), written_out.advance(*arguments), atol=1e-12
    )


def test_elimination_knows_what_fills():
    body = load_system("fish").body
    columns, size = fill_in(len(body.masses), body.springs), len(body.masses)
    matrix = np.eye(size) * 20
    for a, b in body.springs:
        matrix[a, b] = matrix[b, a] = -1
    order = list(columns)
    lower = np.linalg.cholesky(matrix[np.ix_(order, order)])
    filled = {(order[j], order[i]) for i, j in np.argwhere(np.tril(lower, -1))}
    assert filled == {(k, i) for k, below in columns.items() for i in below}


def test_without_a_compiler_there_is_no_twin(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    assert c_twin(load_system("fish").body) is None


def test_a_compiler_that_fails_gives_no_twin(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiler, "find_compiler", lambda: "/bin/false")
    assert c_twin(replace(dropped_body(), masses=np.ones(4))) is None
