"""A motion far away is the same motion, to the last byte, and a long one keeps its digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

from neuroanimator import Emulator, load_emulator, load_policy, set_backend
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.codegen.zig import zig_cc
from neuroanimator.control.policies.closed_loop import rollout_on_emulator
from neuroanimator.control.policies.steering import SteeringTarget, steer_forward
from neuroanimator.emulator.origin import NOWHERE
from neuroanimator.emulator.super_step import rollout, step
from neuroanimator.export.programs.c_file import Call, compiled_header
from neuroanimator.export.programs.c_header import c_header, stored_latent_size
from neuroanimator.export.programs.definition import definition_of
from neuroanimator.export.programs.wasm_file import WasmModule, wasm_bytes
from neuroanimator.files.zoo import EMULATORS
from neuroanimator.gym.state_rows import EmulatorStepper
from neuroanimator.state.pose import Pose

STEPS = 6
BATCH = 5
GRID = 2.0**-10
"""Positions of starts are multiples of it: float32 holds them 2 km away, too."""

EVERY = sorted(path.name.split(".")[0] for path in EMULATORS.glob("*.emulator.safetensors"))
NAMES = [
    name if name == "lander-50" else pytest.param(name, marks=pytest.mark.endurance)
    for name in EVERY
]


@pytest.fixture(autouse=True)
def own_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test chooses ends with it."""
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [])


BACKENDS = [
    pytest.param("c", marks=pytest.mark.skipif(find_compiler() is None, reason="no C compiler")),
    "jax",
]


@dataclass(frozen=True)
class Pair:
    """Starts, the same starts moved a kilometre away, and controls."""

    emulator: Emulator
    near: Float[np.ndarray, "B S"]
    way: Float[np.ndarray, " A"]
    controls: Float[np.ndarray, "B T C"]

    @classmethod
    def of(cls, emulator: Emulator, seed: int = 0) -> Pair:
        rng = np.random.default_rng(seed)
        near = np.tile(np.round(emulator.rest / GRID) * GRID, (BATCH, 1))
        way = rng.choice([-1, 1], emulator.origin.state.size) * rng.integers(
            800, 1200, emulator.origin.state.size
        )
        shares = rng.uniform(-1, 1, (BATCH, STEPS, emulator.control.size))
        controls = emulator.bounds.middle + shares * emulator.bounds.half
        return cls(emulator, near, way.astype(float), controls)

    @property
    def far(self) -> Float[np.ndarray, "B S"]:
        return self.emulator.origin.state.moved(self.near, self.way)

    def back(self, states: Float[np.ndarray, "*B S"]) -> Float[np.ndarray, "*B S"]:
        return self.emulator.origin.state.moved(states, -self.way)

    @property
    def others(self) -> Float[np.ndarray, " S"]:
        """Return a mask of the entries that are no positions."""
        return np.array(self.emulator.origin.state.of_entries) == NOWHERE


def test_every_body_that_moves_freely_may_be_moved():
    expected = {"pendulum-50": 0, "lander-50": 2, "truck-50": 2, "fish-50": 3, "cape-40": 3}
    assert {name: load_emulator(name).origin.state.size for name in expected} == expected


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", NAMES)
def test_a_motion_a_kilometre_away_has_the_same_bytes(name: str, backend: str):
    pair = Pair.of(load_emulator(name))
    emulator = pair.emulator
    set_backend(backend)
    for near, far, held in (
        (pair.near, pair.far, pair.controls),
        (pair.near[0], pair.far[0], pair.controls[0]),
    ):
        expected = emulator.rollout(near, held)
        assert expected.dtype == np.float64
        np.testing.assert_array_equal(pair.back(emulator.rollout(far, held)), expected)
        states, scores = emulator.rollout_trusted(near, held)
        moved, same = emulator.rollout_trusted(far, held)
        np.testing.assert_array_equal(pair.back(moved), states)
        np.testing.assert_array_equal(same, scores)
    first = pair.controls[0, 0]
    after = emulator.step(pair.near[0], first)
    np.testing.assert_array_equal(pair.back(emulator.step(pair.far[0], first)), after)
    trust = emulator.trust(pair.near[0], first)
    assert emulator.trust(pair.far[0], first) == trust
    single = emulator.rollout(pair.far.astype(np.float32), pair.controls)
    assert single.dtype == np.float32
    double = emulator.rollout(pair.far, pair.controls)
    if np.array_equal(pair.far, pair.far.astype(np.float32)):
        np.testing.assert_array_equal(single, double.astype(np.float32))


@pytest.mark.parametrize("name", NAMES)
def test_in_jax_all_but_the_position_has_the_same_bytes(name: str):
    pair = Pair.of(load_emulator(name))
    near, far, controls = (
        jnp.asarray(a, jnp.float32) for a in (pair.near, pair.far, pair.controls)
    )
    for function, held in ((rollout, controls), (step, controls[:, 0])):
        run = jax.jit(jax.vmap(function, (None, 0, 0)))
        expected = np.asarray(run(pair.emulator, near, held))
        moved = np.asarray(run(pair.emulator, far, held))
        np.testing.assert_array_equal(moved[..., pair.others], expected[..., pair.others])
        np.testing.assert_allclose(pair.back(moved.astype(float)), expected, rtol=0, atol=1e-3)


def call_header(emulator: Emulator) -> Call:
    """Return the functions of the emulator's C header."""
    text = c_header(emulator, definition_of(emulator), "it", has_gradient=False)
    return compiled_header(text, "it")


def call_module(emulator: Emulator) -> Call:
    """Return the functions of the emulator's WebAssembly module."""
    if zig_cc() is None:
        pytest.skip("no Zig: pip install 'neuroanimator[wasm]'")
    wasmtime = pytest.importorskip("wasmtime")
    content = wasm_bytes(emulator, definition_of(emulator), "it", has_gradient=False)
    return WasmModule(wasmtime, content, "it").call


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize(
    "made", [call_header, pytest.param(call_module, marks=pytest.mark.endurance)]
)
@pytest.mark.parametrize("name", NAMES)
def test_in_a_program_all_but_the_position_has_the_same_bytes(
    name: str, made: Callable[[Emulator], Call]
):
    pair = Pair.of(load_emulator(name))
    emulator = pair.emulator
    call = made(emulator)
    found = {}
    for place, starts in (("near", pair.near), ("far", pair.far)):
        states = starts.astype(np.float32)
        held = np.ascontiguousarray(pair.controls.swapaxes(0, 1), np.float32)
        latents = np.zeros((BATCH, stored_latent_size(emulator)), np.float32)
        for state, latent in zip(states, latents, strict=True):
            call("encode", state, latent)
        advanced = np.zeros_like(states)
        for controls in held:
            call("advance_batch", latents, controls, BATCH, advanced)
        path = np.zeros((STEPS + 1, emulator.state.size), np.float32)
        call("rollout", states[0], np.ascontiguousarray(held[:, 0]), STEPS, path)
        stepped = np.zeros_like(states)
        call("step_batch", states, held[0], BATCH, stepped)
        found[place] = (advanced, path, stepped)
    for near, far in zip(found["near"], found["far"], strict=True):
        np.testing.assert_array_equal(far[..., pair.others], near[..., pair.others])
        np.testing.assert_allclose(pair.back(far.astype(float)), near, rtol=0, atol=1e-3)


def test_an_environment_and_a_policy_do_the_same_far_away():
    pair = Pair.of(load_emulator("fish-50"))
    found = []
    for states in (pair.near, pair.far):
        leap = EmulatorStepper(pair.emulator, np.inf, 0.0)
        is_new = np.ones(BATCH, bool)
        for controls in pair.controls.swapaxes(0, 1):
            states = leap(states, controls, is_new).states
            is_new = np.zeros(BATCH, bool)
        found.append(states)
    np.testing.assert_array_equal(pair.back(found[1]), found[0])

    def ahead(pose: Pose, time: object) -> SteeringTarget:
        return steer_forward(pose, 0.1)

    policy = load_policy("fish")
    paths = [
        np.asarray(rollout_on_emulator(policy, ahead, starts, STEPS))
        for starts in (pair.near, pair.far)
    ]
    np.testing.assert_array_equal(paths[1][..., pair.others], paths[0][..., pair.others])


@pytest.mark.parametrize("backend", BACKENDS)
def test_chained_steps_are_a_rollout_and_lose_no_digits_far_away(backend: str):
    emulator = load_emulator("truck-50")
    pair = Pair.of(emulator)
    set_backend(backend)
    near, far = pair.near[0], pair.far[0]
    controls = np.resize(pair.controls[0], (300, emulator.control.size))
    for held in controls:
        near = emulator.step(near, held)
        far = emulator.step(far, held)
    np.testing.assert_array_equal(pair.back(far), near)
    path = emulator.rollout(pair.near[0], controls)
    np.testing.assert_allclose(path[-1], near, rtol=0, atol=1e-6)


@pytest.mark.endurance
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_hundred_thousand_super_steps_lose_no_digits(backend: str):
    """The way is the sum of the ways of its super steps, each as from the world's origin."""
    emulator = load_emulator("lander-50")
    set_backend(backend)
    state = np.array(emulator.rest)
    state[2] = 50.0
    held = np.tile(emulator.bounds.idle, (100_000, 1))
    path = emulator.rollout(state, held, may_diverge=True)
    ways = np.diff(path[:, :2], axis=0)
    np.testing.assert_allclose(path[-1, :2] - path[0, :2], ways.sum(axis=0), rtol=0, atol=1e-9)
    begun = path[-2].copy()
    begun[:2] = 0.0
    np.testing.assert_allclose(emulator.step(begun, held[0])[:2], ways[-1], rtol=0, atol=1e-9)
