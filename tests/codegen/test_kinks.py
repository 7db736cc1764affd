"""At kinks, where two slopes are right, C decides as JAX does: in random functions of whatever has one, at ties and beside them.

All numbers are small multiples of a sixteenth, so that both compute without rounding: then ties are ties in both, and
the numbers beside them lie on the same side. What programs do where rounding decides, the tests of exports hold.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_c_function import compiled, needs_compiler, pulled_back, room, without_module

from neuroanimator.codegen.c_function import c_function
from neuroanimator.codegen.program import WIDTH, Constants
from neuroanimator.codegen.trace import Input, UnsupportedError

SIZE = 24
"""Numbers of every vector here."""

DEPTH = 5
"""Operations that a random function chains."""

TRIES = 50
"""Inputs that every function is tried at."""

LEVELS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Values on which kinks and inputs lie, and so meet."""

KINKS: dict[str, Callable[..., jax.Array]] = {
    "maximum": lambda x, y, a: jnp.maximum(x, y),
    "maximum of a number": lambda x, y, a: jnp.maximum(x, a),
    "minimum": lambda x, y, a: jnp.minimum(x, y),
    "minimum of a number": lambda x, y, a: jnp.minimum(a, x),
    "clip": lambda x, y, a: jnp.clip(x, min(a, 0.5), 0.5),
    "clip to one number": lambda x, y, a: jnp.clip(x, a, a) + y,
    "clip between numbers": lambda x, y, a: jnp.clip(x, jnp.minimum(y, a), jnp.maximum(y, a)),
    "clamp": lambda x, y, a: jax.lax.clamp(-abs(a), x, abs(a)),
    "clamp to an empty range": lambda x, y, a: jax.lax.clamp(a + 0.5, x, a),
    "abs": lambda x, y, a: jnp.abs(x - a),
    "relu": lambda x, y, a: jax.nn.relu(x - a),
    "leaky": lambda x, y, a: jax.nn.leaky_relu(x - a, 0.5),
    "where larger": lambda x, y, a: jnp.where(x > a, x, 2 * y),
    "where no smaller": lambda x, y, a: jnp.where(x >= y, 2 * x, y),
    "where alike": lambda x, y, a: jnp.where(x == y, x + y, x - y),
    "sign": lambda x, y, a: jnp.sign(x - a) * y,
    "floor": lambda x, y, a: jnp.floor(2 * x) + y,
    "round": lambda x, y, a: jnp.round(x) + y,
    "round halves up": lambda x, y, a: jax.lax.round(2 * x) + y,
    "largest": lambda x, y, a: jnp.max(x.reshape(4, -1), axis=1, keepdims=True).repeat(6) + y,
    "least": lambda x, y, a: jnp.min(x.reshape(-1, 4), axis=0, keepdims=True).repeat(6) - y,
    "distance from both": lambda x, y, a: jnp.abs(jnp.maximum(x - a, y) - jnp.minimum(x, y + a)),
}


def random_function(seed: int) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Return a function of two vectors that chains `DEPTH` of `KINKS`."""
    rng = np.random.default_rng(seed)
    chosen = [KINKS[name] for name in rng.choice(list(KINKS), DEPTH)]
    levels = rng.choice(LEVELS, DEPTH).tolist()

    def function(x: jax.Array, y: jax.Array) -> jax.Array:
        for kink, level in zip(chosen, levels, strict=True):
            x, y = kink(x, y, level), 0.5 * (x - y[::-1])
        return x - y

    return function


def inputs_at_kinks(rng: np.random.Generator) -> list[np.ndarray]:
    """Return two vectors: a third of their numbers on `LEVELS`, a third a little to either side, a third anywhere."""
    vectors = []
    for _ in range(2):
        numbers = rng.choice(LEVELS, SIZE) + rng.choice([-1, 0, 1], SIZE) / 16
        anywhere = rng.integers(-32, 33, SIZE) / 16
        vectors.append(np.where(rng.random(SIZE) < 2 / 3, numbers, anywhere).astype(np.float32))
    return vectors


@needs_compiler
@pytest.mark.parametrize("name", KINKS)
def test_c_has_the_slope_of_jax_at_every_kink_and_beside_it(name: str):
    def at_all_levels(x: jax.Array, y: jax.Array) -> jax.Array:
        return sum((KINKS[name](x, y, level) for level in LEVELS), jnp.zeros(SIZE))

    hold_against_jax(at_all_levels, is_wide=False)


@needs_compiler
@pytest.mark.parametrize("is_wide", [False, True], ids=["one cotangent", "sixteen cotangents"])
@pytest.mark.parametrize("seed", range(8))
def test_c_decides_as_jax_does_in_random_functions(seed: int, is_wide: bool):
    hold_against_jax(random_function(seed), is_wide=is_wide)


def test_a_choice_among_more_than_two_is_refused():
    function = lambda _, x: jax.lax.select_n(jnp.int32(x > 0) + (x > 1), x, 2 * x, 3 * x)  # noqa: E731
    with pytest.raises(UnsupportedError, match="select_n"):
        c_function("it", function, None, [Input((SIZE,))], constants=Constants())


def hold_against_jax(function: Callable, *, is_wide: bool) -> None:
    """Assert that values and cotangents are the same to the last bit at inputs that lie at kinks."""
    pull = pulled_back(function)
    constants = Constants()
    late = Input((SIZE,), is_wide=is_wide, is_late=True)
    inputs = [Input((SIZE,)), Input((SIZE,)), late]
    written = c_function("it", without_module(pull), None, inputs, constants=constants)
    call = compiled(written, constants)
    in_jax = jax.jit(pull)
    tape = room(written.tape + WIDTH)
    wide_tape = room(WIDTH * (written.wide_tape + 1))
    rng = np.random.default_rng(0)
    lanes = (WIDTH,) if is_wide else ()
    for _ in range(TRIES):
        x, y = inputs_at_kinks(rng)
        cotangents = (rng.integers(-8, 9, (SIZE, *lanes)) / 8).astype(np.float32)
        value = room(SIZE)
        call("it_forward", [x, y, tape, wide_tape, value])
        of_x = room(SIZE, *lanes)
        of_y = room(SIZE, *lanes)
        call("it_backward", [tape, wide_tape, cotangents, of_x, of_y])
        first = cotangents[:, 0] if is_wide else cotangents
        expected = in_jax(x, y, first)
        found = [of_x[:, 0], of_y[:, 0]] if is_wide else [of_x, of_y]
        for one, other in zip([value, *found], expected, strict=True):
            np.testing.assert_array_equal(one, other)
