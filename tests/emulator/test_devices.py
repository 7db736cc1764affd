"""Whatever JAX runs on, a super step is that of C to the rounding of float32; bit-identity is promised on processors alone."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import load_emulator, set_backend
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.emulator.c_emulator import c_emulator
from neuroanimator.emulator.probes import probes_of

ROUNDING = 1e-5
"""Of the largest number of a state."""

PRECISION = "import neuroanimator.emulator, jax; print(jax.config.jax_default_matmul_precision)"

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("name", ["pendulum-50", "fish-50"])
def test_a_super_step_on_every_device_is_that_of_c(name: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("neuroanimator.codegen.backend._chosen", [])
    set_backend("c")
    emulator = load_emulator(name)
    program = c_emulator(emulator)
    assert program is not None
    _, held = probes_of(emulator).inputs
    rest = np.tile(np.asarray(emulator.rest, np.float32), (64, 1))
    controls = np.ascontiguousarray(held[:64, None], np.float32)
    in_c, are_sound = program.rollouts(rest, controls)
    assert are_sound
    for device in {jax.devices()[0], jax.devices("cpu")[0]}:
        with jax.default_device(device):
            in_jax = emulator.rollout(jnp.asarray(rest), jnp.asarray(controls))
        off = np.abs(np.asarray(in_jax) - in_c).max()
        assert off <= ROUNDING * np.abs(in_c).max(), device


def precision(**environment: str) -> str:
    """Return the precision of matrix products in a new process."""
    result = subprocess.run(
        [sys.executable, "-c", PRECISION],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return result.stdout.strip()


def test_products_of_matrices_are_not_rounded_where_there_may_be_a_gpu(tmp_path: Path):
    (tmp_path / "jax_plugins").mkdir()  # as the package that drives GPUs brings it
    path = os.pathsep.join([str(tmp_path), str(ROOT / "src")])
    assert precision(PYTHONPATH=path) == "highest"
    assert precision(PYTHONPATH=path, JAX_DEFAULT_MATMUL_PRECISION="default") == "default"


def test_the_benchmark_says_in_one_line_that_no_gpu_is_at_hand():
    result = subprocess.run(
        [sys.executable, "-m", "benchmarks.gpu.gpu"],
        cwd=ROOT,
        env={**os.environ, "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(ROOT / "src")},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0
    assert result.stdout.startswith("No GPU is at hand: nothing was measured.")
    assert len(result.stdout.splitlines()) == 1
