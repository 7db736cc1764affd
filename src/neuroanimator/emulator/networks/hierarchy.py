"""A hierarchy of networks: one for how the parts of a body move, and a small one for each part itself.

The seminar paper's section 4: what happens within a segment of a fish, or a limb of a human, depends on the
whole through little more than how that part is moved. The upper network sees the whole coarsely; every child
sees its own part finely, and what the upper one has just answered about it and its neighbours.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.features import reordered
from neuroanimator.emulator.networks.glu import LinearGlu
from neuroanimator.emulator.networks.mirrored import Mirrored
from neuroanimator.emulator.networks.network import Network, prefixed
from neuroanimator.errors import ArgumentError
from neuroanimator.parsing.names import check_label
from neuroanimator.parsing.numbers import entries, whole
from neuroanimator.state.layout import MAX_NUMBERS
from neuroanimator.text import quoted

Entries = tuple[int, ...]

MAX_PARTS = 200
"""A file may come from a stranger, and each part is traced; a model has at most as many freedoms."""

ENTRY_KEYS = ("odd", "even", "answers", "hears")
"""Of a part as JSON."""


@dataclass(frozen=True)
class Part:
    """What one network of the hierarchy sees and answers."""

    name: str
    odd: Entries
    """Entries of the odd stream it sees."""
    even: Entries
    """Entries of the even stream it sees."""
    answers: Entries
    """Numbers of the change it predicts."""
    hears: Entries = ()
    """Answers of the upper network it sees too, as numbers of the change; none of the upper network's own."""
    like: int = -1
    """Number of the earlier child whose weights it uses; -1: its own."""


class Hierarchy(Network):
    """An upper network, and children side by side in one computation, each padded to the largest."""

    upper: LinearGlu | Mirrored
    children: LinearGlu | Mirrored
    """Arrays have a leading axis: one entry for each child with weights of its own."""
    parts: tuple[Part, ...] = eqx.field(static=True)
    """The upper one first."""
    even: Entries = eqx.field(static=True)
    """Which answers are even in the mirror; none where there is no mirror."""

    def __init__(
        self,
        odd: int,
        even: int,
        out: int,
        widths: tuple[int, ...],
        *,
        key: PRNGKeyArray,
        even_out: Entries,
        parts: tuple[Part, ...],
    ):
        """`widths` are the upper network's hidden layers, then a 0, then those of every child."""
        check_parts(parts, odd, even, out, widths)
        self.parts, self.even = parts, tuple(even_out)
        middle, keys = widths.index(0), jax.random.split(key)
        self.upper = self._make(parts[:1], widths[:middle], keys[0])
        own = sum(part.like < 0 for part in parts[1:])

        def make(key):
            return self._make(parts[1:], widths[middle + 1 :], key)

        self.children = eqx.filter_vmap(make)(jax.random.split(keys[1], own))

    def _make(
        self, parts: tuple[Part, ...], widths: tuple[int, ...], key: PRNGKeyArray
    ) -> LinearGlu | Mirrored:
        """Return a network large enough for each of `parts`; its odd answers come first."""
        odd_in, even_in = (max(len(self._inputs(part)[i]) for part in parts) for i in range(2))
        odd_out, even_out = (max(len(self._answers(part)[i]) for part in parts) for i in range(2))
        if not self.even:
            return LinearGlu(odd_in, even_in, odd_out, widths, key=key)
        rising = tuple(range(odd_out, odd_out + even_out))
        return Mirrored(odd_in, even_in, odd_out + even_out, widths, key=key, even_out=rising)

    def _inputs(self, part: Part) -> tuple[list[int], list[int]]:
        """Return a part's inputs: entries of the odd and the even stream, and -1, -2 ... for answers it hears."""
        odd, even = self._answers(self.parts[0])
        hears = [
            [-1 - answers.index(i) for i in part.hears if i in answers] for answers in (odd, even)
        ]
        return [*part.odd, *hears[0]], [*part.even, *hears[1]]

    def _answers(self, part: Part) -> tuple[list[int], list[int]]:
        """Return a part's odd and even answers."""
        return [i for i in part.answers if i not in self.even], [
            i for i in part.answers if i in self.even
        ]

    def leaves(self) -> dict[str, Any]:
        upper = prefixed("upper", self.upper.leaves())
        children = prefixed("children", self.children.leaves())
        return {**upper, **children}

    @property
    def widths(self) -> tuple[int, ...]:
        one = jax.tree.map(lambda leaf: leaf[0], eqx.filter(self.children, eqx.is_array_like))
        return (*self.upper.widths, 0, *eqx.combine(one, self.children).widths)

    def __call__(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Float[Array, " S"]:
        above, parts = self.parts[0], self.parts[1:]
        told = self.upper(odd[np.array(above.odd, int)], even[np.array(above.even, int)])
        split = len(self._answers(above)[0])
        streams = zip((odd, even), (told[:split], told[split:]), strict=True)
        rows = [[self._inputs(part)[i] for part in parts] for i in range(2)]
        seen = [_padded(*stream, wanted) for stream, wanted in zip(streams, rows, strict=True)]
        answers = eqx.filter_vmap(lambda network, *both: network(*both))(self._weights(), *seen)
        return reordered(jnp.concatenate([told, answers.ravel()]), self._order(answers.shape[1]))

    def _weights(self) -> LinearGlu | Mirrored:
        """Return the children's networks, one entry per child."""
        own = iter(range(len(self.parts)))
        rows: list[int] = []
        for part in self.parts[1:]:
            rows.append(next(own) if part.like < 0 else rows[part.like])
        if rows == sorted({*rows}):
            return self.children
        return jax.tree.map(
            lambda leaf: leaf[np.array(rows)] if eqx.is_array(leaf) else leaf, self.children
        )

    def _order(self, width: int) -> Entries:
        """Return where each number of the change lies in (upper answers, children's answers padded to `width`)."""
        odd, even = self._answers(self.parts[0])
        slot = {entry: i for i, entry in enumerate([*odd, *even])}
        most = max(len(self._answers(part)[0]) for part in self.parts[1:])
        for number, part in enumerate(self.parts[1:]):
            start = len(odd) + len(even) + number * width
            odd_own, even_own = self._answers(part)
            slot |= {entry: start + i for i, entry in enumerate(odd_own)}
            slot |= {entry: start + most + i for i, entry in enumerate(even_own)}
        return tuple(slot[entry] for entry in range(len(slot)))


def _padded(
    stream: Float[Array, " K"], answers: Float[Array, " A"], rows: list[list[int]]
) -> Float[Array, "G I"]:
    """Return per child what it sees of `stream` and hears of `answers`, filled up with zeros."""
    size, width = stream.shape[0], max(map(len, rows))
    zero = size + answers.shape[0]
    table = [
        [i if i >= 0 else size - 1 - i for i in row] + [zero] * (width - len(row)) for row in rows
    ]
    source = jnp.concatenate([stream, answers, jnp.zeros(1, stream.dtype)])
    return source.at[np.array(table, int).reshape(len(rows), width)].get(mode="promise_in_bounds")


def check_parts(
    parts: tuple[Part, ...], odd: int, even: int, out: int, widths: tuple[int, ...]
) -> None:
    """Refuse parts that do not answer every number exactly once, or see what is not there."""
    answered = sorted(entry for part in parts for entry in part.answers)
    if len(parts) < 2 or answered != list(range(out)):
        raise ArgumentError(
            "hierarchy: every number of the change must belong to exactly one of two or more parts."
        )
    if widths.count(0) != 1 or 0 in (widths[0], widths[-1]) or min(widths) < 0:
        raise ArgumentError(
            f"widths: wanted the upper network's layers, 0, a child's layers; came {list(widths)}."
        )
    for number, part in enumerate(parts[1:]):
        inside = all(0 <= i < odd for i in part.odd) and all(0 <= i < even for i in part.even)
        if not inside or not {*part.hears} <= {*parts[0].answers}:
            raise ArgumentError(
                f"hierarchy: part {quoted(part.name)} sees or hears what is not there."
            )
        if part.like >= number or (part.like >= 0 and _shape(part) != _shape(parts[1 + part.like])):
            raise ArgumentError(
                f"hierarchy: part {quoted(part.name)} cannot use the weights of part {part.like}."
            )


def _shape(part: Part) -> tuple[int, ...]:
    return len(part.odd), len(part.even), len(part.answers), len(part.hears)


def parts_to_json(parts: tuple[Part, ...]) -> list[dict[str, Any]]:
    """Return plain dictionaries."""
    return [asdict(part) for part in parts]


def parts_from_json(rows: Any) -> tuple[Part, ...]:
    """Return the parts `parts_to_json` wrote; ValueError names what is wrong with them."""
    if not isinstance(rows, list) or len(rows) > MAX_PARTS:
        raise ValueError(f"parts: wanted a list of at most {MAX_PARTS}")
    return tuple(_part_from_json(row) for row in rows)


def _part_from_json(row: Any) -> Part:
    if not isinstance(row, dict):
        raise ValueError("parts: a part is no table")
    name = check_label(row["name"], "parts")
    indices = {key: entries(row[key], f"parts: {key} of {name}", MAX_NUMBERS) for key in ENTRY_KEYS}
    for key, found in indices.items():
        if len({*found}) < len(found):
            raise ValueError(f"parts: {key} of {name} names an entry twice")
    like = whole(row["like"], f"parts: like of {name}", -1, MAX_PARTS)
    return Part(name, indices["odd"], indices["even"], indices["answers"], indices["hears"], like)
