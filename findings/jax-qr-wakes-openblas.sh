#!/usr/bin/env bash
# Guess: a small QR decomposition (192 rows and columns, 1 ms) in every tenth round of a compiled loop costs its own time, a few
# percent of the loop, and one thread or two make no difference to it.
#
# Seen instead: on two cores the loop takes 1.3 to 1.8 times as long as with one thread of BLAS, and twice the CPU time. JAX's
# decompositions on CPUs are those of SciPy's OpenBLAS. Its threads, woken by the QR, spin for a while after it, and XLA's
# own threads have to share the cores with them. `OPENBLAS_NUM_THREADS=1` helps, before NumPy is imported; `threadpoolctl` later.
#
# Why it matters: optimisers with eigenbases or orthogonalisation by QR (SOAP, Shampoo), and Kalman filters, decompose small
# matrices again and again between large products.
#
# Versions: jax 0.10.2, scipy 1.17.1, numpy 2.4.6, Python 3.11; at least two cores, not busy.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet jax==0.10.2 scipy==1.17.1 numpy==2.4.6
cat > loop.py <<'PYTHON'
import time

import jax
import jax.numpy as jnp

ROUNDS = 600
weights = jax.random.normal(jax.random.key(0), (128, 192)) / 12
inputs = jax.random.normal(jax.random.key(1), (2048, 128))


def one_round(carry, number):
    weights, basis = carry
    # What a network's layer and its gradient take.
    outputs = jnp.tanh(inputs @ weights)
    gradient = inputs.T @ outputs / 2048
    basis = jax.lax.cond(number % 10 == 0, lambda b: jnp.linalg.qr(gradient.T @ gradient + b)[0], lambda b: b, basis)
    return (weights - 1e-3 * gradient @ basis @ basis.T, basis), None


loop = jax.jit(lambda weights: jax.lax.scan(one_round, (weights, jnp.eye(192)), jnp.arange(ROUNDS))[0])
jax.block_until_ready(loop(weights))
spans = []
for _ in range(5):
    began = time.perf_counter()
    jax.block_until_ready(loop(weights))
    spans.append((time.perf_counter() - began) / ROUNDS)
print(f"{1e3 * min(spans):.3f}")
PYTHON
several=$(venv/bin/python loop.py)
one=$(OPENBLAS_NUM_THREADS=1 venv/bin/python loop.py)
echo "a round takes $several ms with OpenBLAS's own threads, $one ms with one"
venv/bin/python - "$several" "$one" <<'PYTHON'
import os
import sys

if os.cpu_count() < 2:
    sys.exit("Needs two cores.")
several, one = map(float, sys.argv[1:])
sys.exit(0 if several > 1.15 * one else "This has changed: look whether the threads still spin.")
PYTHON
