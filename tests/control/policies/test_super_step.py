"""A policy's super step in C is the one in JAX, and a program that does something else is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import load_emulator, set_backend
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.control.policies import super_step as module
from neuroanimator.control.policies.behaviours import steer_along, wander
from neuroanimator.control.policies.closed_loop import rollout_on_emulator
from neuroanimator.control.policies.policy import Policy, fresh_policy
from neuroanimator.control.policies.steering import SteeringTarget
from neuroanimator.control.policies.super_step import PolicyStep, make_super_step
from neuroanimator.emulator import c_rows
from neuroanimator.state.layout import Bounds
from neuroanimator.state.pose import Pose

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

BODIES = 5


@pytest.fixture
def policy(monkeypatch: pytest.MonkeyPatch) -> Policy:
    """A policy of the lander, untrained: a small program."""
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [])
    ranges = Bounds((0.0, -1.0, -1.0, -1.0), (2.0, 1.0, 1.0, 1.0))
    return fresh_policy(load_emulator("lander-50"), ranges, widths=(8,))


def super_step_in(backend: str, policy: Policy) -> PolicyStep:
    """Return what five bodies do, each on its own way."""
    set_backend(backend)
    rng = np.random.default_rng(1)
    rest = policy.emulator.rest
    states = rest + np.linspace(0.0, 0.1, BODIES)[:, None] * (np.arange(len(rest)) < 3)
    directions = rng.normal(size=(BODIES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    target = SteeringTarget(directions, rng.uniform(0, 3, BODIES))
    phase = rng.uniform(0, 2 * np.pi, BODIES)
    return make_super_step(policy, policy.emulator.encode(states), phase, target)


@needs_compiler
def test_a_super_step_in_c_is_the_one_in_jax(policy: Policy):
    in_c = super_step_in("c", policy)
    in_jax = super_step_in("jax", policy)
    for computed, expected in zip(in_c, in_jax, strict=True):
        assert np.ptp(expected) > 0
        scale = np.abs(expected).max()
        np.testing.assert_allclose(computed, expected, rtol=1e-4, atol=1e-4 * scale)


@needs_compiler
def test_bodies_live_on_the_emulator_in_c_as_in_jax(policy: Policy):
    def go(pose: Pose, time: jax.Array) -> SteeringTarget:
        return steer_along(wander(pose, time), jnp.array([0.5, 1.0]))

    starts = np.tile(policy.emulator.rest, (2, 1))
    starts[1, 0] += 3.0
    lives = []
    for backend in ("c", "jax"):
        set_backend(backend)
        lives.append(rollout_on_emulator(policy, go, starts, 6, seed=2))
    assert all(isinstance(life, jax.Array) for life in lives)
    scale = np.abs(lives[1]).max()
    np.testing.assert_allclose(lives[0], lives[1], rtol=1e-3, atol=1e-4 * scale)


@needs_compiler
def test_a_program_that_does_something_else_is_refused(
    policy: Policy, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    right = c_rows._program

    def wrong(*inputs: Any) -> c_rows.CProgram:
        program = right(*inputs)
        return c_rows.CProgram(program.text, program.constants * np.float32(1.01), program.sizes)

    monkeypatch.setattr(c_rows, "_program", wrong)
    unknown = replace(module.ROWS, about=lambda policy: ["one nobody has made a program of"])
    monkeypatch.setattr(module, "ROWS", unknown)
    in_jax = super_step_in("auto", policy)
    assert "disagrees with policy_super_step in JAX" in capsys.readouterr().err
    set_backend("jax")
    np.testing.assert_array_equal(in_jax.states, super_step_in("jax", policy).states)
