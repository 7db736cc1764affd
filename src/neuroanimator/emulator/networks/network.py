"""Networks from (odd, even) features to the normalised change of state.

`Gated` and `Classic` treat the two streams so that negating the odd one negates the answer, exactly
and at no cost: a mirrored motion is emulated by the mirrored numbers. `Glu` is for systems without
such a mirror.
"""

from __future__ import annotations

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.features import reordered
from neuroanimator.errors import ArgumentError


class Network(eqx.Module):
    """A map (odd, even) → normalised change of state."""

    @property
    @abc.abstractmethod
    def widths(self) -> tuple[int, ...]:
        """Units in each hidden layer."""

    @abc.abstractmethod
    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]: ...


class Classic(Network):
    """One hidden layer of logistic units with biases, as in 1998.

    σ(e + o) - σ(e - o) is odd in o; it is the network of 1998 minus its mirror image.
    """

    odd_in: Float[Array, "O H"]
    even_in: Float[Array, "E H"]
    bias: Float[Array, " H"]
    out: Float[Array, "H S"]

    def __init__(
        self, odd: int, even: int, out: int, widths: tuple[int, ...], *, key: PRNGKeyArray
    ):
        if len(widths) != 1:
            raise ArgumentError(
                f"widths: the classic network has one hidden layer, came {list(widths)}."
            )
        keys = jax.random.split(key, 3)
        self.odd_in = _weights(keys[0], odd, widths[0])
        self.even_in = _weights(keys[1], even, widths[0])
        self.bias = jnp.zeros(widths[0])
        self.out = _weights(keys[2], widths[0], out)

    @property
    def widths(self) -> tuple[int, ...]:
        return (self.bias.shape[0],)

    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        pushed = odd @ self.odd_in
        if not even.shape[0]:  # no mirror: the network of 1998 itself
            return jax.nn.sigmoid(pushed + self.bias) @ self.out
        level = even @ self.even_in + self.bias
        return (jax.nn.sigmoid(level + pushed) - jax.nn.sigmoid(level - pushed)) @ self.out


class GatedLayer(eqx.Module):
    """Products of a saturating and a linear part.

    tanh(odd) · linear(even) is odd again; tanh(odd) · linear(odd) and tanh(even) are even. Torque
    times inverse inertia and speed times speed, which mechanics is made of, are such products.
    """

    odd_in: Float[Array, "O 3*H"]
    """Side by side, because one product is faster than three: tanh of the odd units, tanh and factor of pairs."""
    even_in: Float[Array, "E 2*H"]
    """Side by side: factor of the odd units, tanh of the even units."""
    bias: Float[Array, " 2*H"]

    def __init__(self, odd: int, even: int, half: int, *, key: PRNGKeyArray):
        keys = jax.random.split(key)
        self.odd_in = _weights(keys[0], odd, 3 * half)
        self.even_in = _weights(keys[1], even, 2 * half)
        self.bias = jnp.concatenate([jnp.ones(half), jnp.zeros(half)])

    def __call__(
        self, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> tuple[Float[Array, " H"], Float[Array, " H"]]:
        angle_like, pair, factor = jnp.split(odd @ self.odd_in, 3)
        gate, level = jnp.split(even @ self.even_in + self.bias, 2)
        return jnp.tanh(angle_like) * gate, jnp.tanh(pair) * factor + jnp.tanh(level)


class Gated(Network):
    """Layers of gated units, then a linear map. The default."""

    layers: tuple[GatedLayer, ...]
    out: Float[Array, "H S"]

    def __init__(
        self, odd: int, even: int, out: int, widths: tuple[int, ...], *, key: PRNGKeyArray
    ):
        _check_halves(widths)
        keys = jax.random.split(key, len(widths) + 1)
        layers = []
        for width, layer_key in zip(widths, keys[1:], strict=True):
            layers.append(GatedLayer(odd, even, width // 2, key=layer_key))
            odd = even = width // 2
        self.layers = tuple(layers)
        self.out = 0.1 * _weights(keys[0], odd, out)

    @property
    def widths(self) -> tuple[int, ...]:
        return tuple(layer.bias.shape[0] for layer in self.layers)

    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        for layer in self.layers:
            odd, even = layer(odd, even)
        return odd @ self.out


class Mirrored(Network):
    """A linear map plus layers of gated units as in `Gated`, for bodies with a left and a right.

    Springs are nearly linear: the linear map alone leaves an eighth of the change unexplained. In the mirror the
    odd answers change sign and the even ones stay, exactly: what is learnt of a turn to the left holds for a turn
    to the right. At equal width it costs half of `Glu`.
    """

    layers: tuple[GatedLayer, ...]
    odd_out: Float[Array, "H O"]
    even_out: Float[Array, "H E"]
    odd_linear: Float[Array, "I O"]
    even_linear: Float[Array, "J E"]
    even: tuple[int, ...] = eqx.field(static=True)
    """Which answers are even."""

    def __init__(
        self, odd: int, even: int, out: int, widths: tuple[int, ...], *, key: PRNGKeyArray, even_out
    ):
        _check_halves(widths)
        keys = jax.random.split(key, len(widths) + 2)
        self.even = tuple(even_out)
        layers, answers = [], (out - len(self.even), len(self.even))
        self.odd_linear, self.even_linear = (
            jnp.zeros((odd, answers[0])),
            jnp.zeros((even, answers[1])),
        )
        for width, layer_key in zip(widths, keys[2:], strict=True):
            layers.append(GatedLayer(odd, even, width // 2, key=layer_key))
            odd = even = width // 2
        self.layers = tuple(layers)
        self.odd_out = 0.1 * _weights(keys[0], odd, answers[0])
        self.even_out = 0.1 * _weights(keys[1], even, answers[1])

    @property
    def widths(self) -> tuple[int, ...]:
        return tuple(layer.bias.shape[0] for layer in self.layers)

    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        linear = odd @ self.odd_linear, even @ self.even_linear
        for layer in self.layers:
            odd, even = layer(odd, even)
        answers = jnp.concatenate(
            [linear[0] + odd @ self.odd_out, linear[1] + even @ self.even_out]
        )
        first_even = self.odd_out.shape[1]
        slot = {entry: first_even + i for i, entry in enumerate(self.even)}
        odd_slots = iter(range(first_even))
        order = tuple(slot[i] if i in slot else next(odd_slots) for i in range(answers.shape[0]))
        return reordered(answers, order)


class Glu(Network):
    """Layers tanh(W x + a) · (V x + b), then a linear map: gated units where there is no mirror to respect."""

    layers: tuple[Float[Array, "I 2*H"], ...]
    """Side by side: saturating part, linear part."""
    biases: tuple[Float[Array, " 2*H"], ...]
    out: Float[Array, "H S"]

    def __init__(
        self, odd: int, even: int, out: int, widths: tuple[int, ...], *, key: PRNGKeyArray
    ):
        keys = jax.random.split(key, len(widths) + 1)
        sizes = [odd + even, *widths]
        self.layers = tuple(
            _weights(k, rows, 2 * width)
            for k, rows, width in zip(keys[1:], sizes, widths, strict=False)
        )
        self.biases = tuple(
            jnp.concatenate([jnp.zeros(width), jnp.ones(width)]) for width in widths
        )
        self.out = 0.1 * _weights(keys[0], sizes[-1], out)

    @property
    def widths(self) -> tuple[int, ...]:
        return tuple(bias.shape[0] // 2 for bias in self.biases)

    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        units = jnp.concatenate([odd, even]) if even.shape[0] else odd
        for layer, bias in zip(self.layers, self.biases, strict=True):
            saturating, linear = jnp.split(units @ layer + bias, 2)
            units = jnp.tanh(saturating) * linear
        return units @ self.out


class LinearGlu(Network):
    """A linear map plus the layers of `Glu`, as `Mirrored` has one: what is nearly linear needs no units."""

    glu: Glu
    linear: Float[Array, "I S"]

    def __init__(
        self, odd: int, even: int, out: int, widths: tuple[int, ...], *, key: PRNGKeyArray
    ):
        self.glu = Glu(odd, even, out, widths, key=key)
        self.linear = jnp.zeros((odd + even, out))

    @property
    def widths(self) -> tuple[int, ...]:
        return self.glu.widths

    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        seen = jnp.concatenate([odd, even]) if even.shape[0] else odd
        return self.glu(odd, even) + seen @ self.linear


def _check_halves(widths: tuple[int, ...]) -> None:
    if any(width % 2 for width in widths):
        raise ArgumentError(
            f"widths: gated layers are half odd, half even units; came {list(widths)}, want even."
        )


def _weights(key: PRNGKeyArray, rows: int, columns: int) -> Float[Array, "rows columns"]:
    """Normal weights that keep numbers of order one of order one."""
    return jax.random.normal(key, (rows, columns)) / jnp.sqrt(max(rows, 1))
