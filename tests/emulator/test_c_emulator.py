"""An emulator's program in C is the emulator: where NumPy goes in and comes out, nobody can tell them apart."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import Emulator, load_emulator, set_backend
from neuroanimator.codegen import compiler
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.emulator import c_emulator as module
from neuroanimator.emulator.c_emulator import c_emulator, c_program
from neuroanimator.emulator.super_step import trust
from neuroanimator.errors import ArgumentError, NeuroAnimatorError, ResourceError

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")

DRIFT = 1e-3
"""Of the largest number of a state: both are float32, and differences add up over a motion."""


@pytest.fixture
def in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [])
    set_backend("c")


def motion(emulator: Emulator, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rest and random controls (T, C)."""
    rng = np.random.default_rng(seed)
    bounds = emulator.bounds
    shares = rng.uniform(-1, 1, (steps, len(bounds.half)))
    return emulator.rest, bounds.middle + shares * bounds.half


def assert_close(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_allclose(found, expected, rtol=DRIFT, atol=DRIFT * np.abs(expected).max())


@needs_compiler
@pytest.mark.parametrize(
    "name",
    [
        "fish-50",
        "cube",
        pytest.param("truck-50", marks=pytest.mark.endurance),
        pytest.param("lander-50", marks=pytest.mark.endurance),
        pytest.param("pendulum-50", marks=pytest.mark.endurance),
        pytest.param("pendulum-passive-50", marks=pytest.mark.endurance),
    ],
)
def test_rollouts_and_steps_are_those_of_jax(name: str, untrained_cube: Emulator, in_c: None):
    emulator = untrained_cube if name == "cube" else load_emulator(name)
    state, controls = motion(emulator, 8, 0)
    expected = np.asarray(emulator.rollout(jnp.asarray(state), jnp.asarray(controls)))
    trajectory = emulator.rollout(state, controls)
    assert isinstance(trajectory, np.ndarray)
    assert_close(trajectory, expected)
    assert_close(emulator.step(state, controls[0]), expected[1])
    program = c_emulator(emulator)
    assert program is not None
    scores = jax.vmap(trust, (None, 0, None))(
        emulator, jnp.asarray(expected), jnp.asarray(controls[0])
    )
    rows = np.float32(expected)
    held = np.tile(np.float32(controls[0]), (len(rows), 1))
    _, found = program.rollouts_trusted(rows, held[:, None])
    np.testing.assert_allclose(found[:, 0], scores, rtol=DRIFT, atol=DRIFT)


@needs_compiler
def test_a_batch_is_its_motions_whatever_their_number(in_c: None):
    emulator = load_emulator("pendulum-50")
    starts = []
    controls = []
    for seed in range(19):
        state, held = motion(emulator, 6, seed)
        starts.append(state + 0.01 * seed)
        controls.append(held)
    together = emulator.rollout(np.stack(starts), np.stack(controls))
    for start, held, found in zip(starts, controls, together, strict=True):
        assert_close(found, emulator.rollout(start, held))


@needs_compiler
def test_numbers_may_lie_in_memory_in_any_way(in_c: None):
    emulator = load_emulator("pendulum-50")
    state, controls = motion(emulator, 3, 0)
    expected = emulator.rollout(state.astype(np.float32), controls.astype(np.float32))
    spread = np.repeat(state, 2)[::2]
    transposed = np.asfortranarray(controls)
    transposed.flags.writeable = False
    for start, held in ((state, controls), (spread, transposed), (list(state), controls.tolist())):
        np.testing.assert_array_equal(emulator.rollout(start, held), expected)
        np.testing.assert_array_equal(emulator.step(start, held[0]), expected[1])


def faults(name: str, number: float) -> Iterator[str]:
    """Yield what is said of a start, and of controls, with `number` among them, alone and among others."""
    set_backend(name)
    emulator = load_emulator("pendulum-50")
    state, controls = motion(emulator, 3, 0)
    for spoilt in (state, controls):
        before = spoilt.flat[-1]
        spoilt.flat[-1] = number
        for call in (
            lambda: emulator.step(state, controls[-1]),
            lambda: emulator.rollout(state, controls),
            lambda: emulator.rollout(np.tile(state, (5, 1)), np.tile(controls, (5, 1, 1))),
        ):
            try:
                call()
                yield "nothing"
            except NeuroAnimatorError as error:
                yield str(error)
        spoilt.flat[-1] = before


@needs_compiler
@pytest.mark.parametrize("number", [np.nan, -np.inf, 1e6, np.nextafter(1e6, 2e6), -1e300])
def test_faults_are_found_and_said_as_in_jax(number: float, in_c: None):
    assert list(faults("c", number)) == list(faults("jax", number))


@needs_compiler
@pytest.mark.parametrize("backend", ["c", "jax"])
def test_no_motions_and_no_super_steps_are_nothing(backend: str, in_c: None):
    set_backend(backend)
    emulator = load_emulator("pendulum-50")
    size, controls = emulator.state.size, emulator.control.size
    assert emulator.rollout(np.zeros((0, size)), np.zeros((0, 3, controls))).shape == (0, 4, size)
    assert emulator.rollout(np.zeros((0, size)), np.zeros((0, 0, controls))).shape == (0, 1, size)
    assert emulator.rollout(emulator.rest, np.zeros((0, controls))).shape == (1, size)
    states, scores = emulator.rollout_trusted(np.zeros((0, size)), np.zeros((0, 3, controls)))
    assert (states.shape, scores.shape) == ((0, 4, size), (0, 3))


@needs_compiler
@pytest.mark.parametrize("name", ["pendulum-50", "fish-50"])
def test_a_step_refuses_what_a_rollout_refuses(name: str, in_c: None):
    emulator = load_emulator(name)
    state, controls = motion(emulator, 1, 0)
    state[0] = 1e20
    with pytest.raises(ArgumentError) as of_rollout:
        emulator.rollout(state, controls)
    with pytest.raises(ArgumentError) as of_step:
        emulator.step(state, controls[0])
    assert str(of_step.value) == str(of_rollout.value)
    assert "is 1e+20; wanted a magnitude of at most 1e+06" in str(of_step.value)


@needs_compiler
def test_arrays_of_jax_stay_with_jax(in_c: None):
    emulator = load_emulator("pendulum-50")
    state, controls = motion(emulator, 3, 0)
    start = jnp.asarray(state)
    assert isinstance(emulator.rollout(start, jnp.asarray(controls)), jax.Array)
    assert isinstance(emulator.step(start, jnp.asarray(controls[0])), jax.Array)
    slope = jax.grad(lambda control: emulator.step(start, control).sum())(jnp.asarray(controls[0]))
    assert np.isfinite(slope).all()


@needs_compiler
def test_a_program_that_does_something_else_is_refused(
    shipped: Emulator, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    right = c_program(shipped)

    def wrong(emulator: Emulator) -> module.CProgram:
        return module.CProgram(right.text, right.constants * np.float32(1.01), {})

    monkeypatch.setattr(module, "c_program", wrong)
    another = eqx.tree_at(lambda emulator: emulator.domain.low, shipped, shipped.domain.low - 1e-3)
    assert c_emulator(another) is None
    assert "disagrees with the emulator in JAX" in capsys.readouterr().err


@needs_compiler
def test_a_program_is_made_once_a_machine_and_a_damaged_one_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made = []

    def counted(emulator: Emulator) -> module.CProgram:
        made.append(emulator)
        return c_program(emulator)

    monkeypatch.setattr(module, "c_program", counted)
    state, controls = motion(load_emulator("pendulum-passive-50"), 4, 0)

    def last_state() -> np.ndarray:
        """Return where a process that has loaded nothing yet ends."""
        monkeypatch.setattr("neuroanimator.codegen.kept._loaded", {})
        program = c_emulator(load_emulator("pendulum-passive-50"))
        assert program is not None
        trajectory, _ = program.rollout(state.astype(np.float32), controls.astype(np.float32))
        return trajectory[-1]

    first = last_state()
    np.testing.assert_array_equal(last_state(), first)
    assert len(made) == 1
    (record,) = (tmp_path / "neuroanimator" / "c-programs").glob("*.safetensors")
    content = bytearray(record.read_bytes())
    content[-10] ^= 1
    record.write_bytes(content)
    np.testing.assert_array_equal(last_state(), first)
    assert len(made) == 2


def test_without_a_compiler_there_is_none_and_jax_takes_over(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiler.shutil, "which", lambda name: None)
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", ["auto"])
    emulator = load_emulator("pendulum-50")
    assert c_emulator(emulator) is None
    state, controls = motion(emulator, 3, 0)
    assert isinstance(emulator.rollout(state, controls), np.ndarray)
    set_backend("c")
    with pytest.raises(ResourceError, match="Install a C compiler"):
        emulator.rollout(state, controls)


def test_an_unknown_backend_is_refused_by_name(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(ArgumentError, match="wanted one of auto, c, jax, got 'cuda'"):
        set_backend("cuda")
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [])
    monkeypatch.setenv("NEUROANIMATOR_BACKEND", "gpu")
    emulator = load_emulator("pendulum-50")
    with pytest.raises(ArgumentError, match="NEUROANIMATOR_BACKEND: wanted one of"):
        emulator.step(emulator.rest, np.zeros(3))
