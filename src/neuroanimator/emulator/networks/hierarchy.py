"""A hierarchy of networks: one for the motion of a body's parts as wholes, and a small one for each part itself.

The seminar paper's section 4: the motion within a segment of a fish, or a limb of a human, depends on the rest of the
body through little more than the motion of that part as a whole. The upper network sees the whole coarsely; every child
sees its own part finely, and the upper network's answers about it and its neighbours.
"""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.features import reordered
from neuroanimator.emulator.networks.glu import LinearGlu
from neuroanimator.emulator.networks.mirrored import Mirrored
from neuroanimator.emulator.networks.network import (
    Entries,
    Network,
    NetworkShape,
    Part,
    Units,
    prefixed,
    split_key,
)
from neuroanimator.errors import ArgumentError
from neuroanimator.files.names import check_label
from neuroanimator.files.numbers import entries, whole
from neuroanimator.state.arrays import AnyArray
from neuroanimator.state.layout import MAX_NUMBERS
from neuroanimator.text import quoted

MAX_PARTS = 200
"""Maximum number of parts, a model's maximum of freedoms: a file may come from a stranger, and each part is traced."""

ENTRY_KEYS = ("odd", "even", "answers", "hears")
"""Keys of a part in JSON."""


def _answers(part: Part, even: Entries) -> tuple[list[int], list[int]]:
    """Return a part's odd and even answers; `even` lists the even ones of all parts."""
    return [i for i in part.answers if i not in even], [i for i in part.answers if i in even]


def _inputs(part: Part, above: Part, even: Entries) -> tuple[list[int], list[int]]:
    """Return a part's inputs: entries of the odd and the even stream, and -1, -2 ... for the answers it sees from `above`."""
    odd_answers, even_answers = _answers(above, even)
    heard_odd = [-1 - odd_answers.index(i) for i in part.hears if i in odd_answers]
    heard_even = [-1 - even_answers.index(i) for i in part.hears if i in even_answers]
    return [*part.odd, *heard_odd], [*part.even, *heard_even]


def _network(
    parts: tuple[Part, ...],
    above: Part,
    even: Entries,
    widths: tuple[int, ...],
    key: PRNGKeyArray | None,
) -> LinearGlu | Mirrored:
    """Return a network large enough for each of `parts`; its odd answers come first."""
    inputs = [_inputs(part, above, even) for part in parts]
    answers = [_answers(part, even) for part in parts]
    odd_in = max(len(odd) for odd, _ in inputs)
    even_in = max(len(even) for _, even in inputs)
    odd_out = max(len(odd) for odd, _ in answers)
    even_out = max(len(even) for _, even in answers)
    if not even:
        return LinearGlu.of(NetworkShape(odd_in, even_in, odd_out, widths), key=key)
    out = odd_out + even_out
    even_last = tuple(range(odd_out, out))
    return Mirrored.of(NetworkShape(odd_in, even_in, out, widths, even_last), key=key)


def _stacked(*leaves: Float[AnyArray, " ..."]) -> Float[AnyArray, " ..."]:
    """Return the children's arrays stacked, one row per child."""
    return as_jax(np.stack([np.asarray(leaf) for leaf in leaves]), leaves[0].dtype)


def _repeated(count: int, leaf: Float[np.ndarray, " ..."]) -> Float[np.ndarray, " ..."]:
    """Return the same array `count` times, in the memory of one."""
    return np.broadcast_to(leaf, (count, *leaf.shape))


class Hierarchy(Network):
    """An upper network, and children in one batched computation, each padded to the largest."""

    usual_widths = (48, 0, 24)

    upper: LinearGlu | Mirrored
    children: LinearGlu | Mirrored
    """Networks of the children; arrays have a leading axis with an entry per child that has its own weights."""
    parts: tuple[Part, ...] = eqx.field(static=True)
    """Parts, the upper one first."""
    even: Entries = eqx.field(static=True)
    """Answers that are even in the mirror; none without a mirror."""

    @classmethod
    def of(cls, shape: NetworkShape, *, key: PRNGKeyArray | None) -> Hierarchy:
        """Return a fresh network; without a key its weights are zeros.

        Its widths are the upper network's hidden layers, then a 0, then those of every child.
        """
        widths = shape.widths
        parts = shape.parts
        check_parts(parts, shape.odd, shape.even, shape.out, widths)
        even = tuple(shape.even_out)
        upper_key, children_key = split_key(key, 2)
        middle = widths.index(0)
        upper = _network(parts[:1], parts[0], even, widths[:middle], upper_key)

        def make_child(key: PRNGKeyArray | None) -> LinearGlu | Mirrored:
            return _network(parts[1:], parts[0], even, widths[middle + 1 :], key)

        with_own_weights = sum(part.like < 0 for part in parts[1:])
        if key is None:
            children = jax.tree.map(partial(_repeated, with_own_weights), make_child(None))
        else:
            keys = split_key(children_key, with_own_weights)
            children = jax.tree.map(_stacked, *(make_child(key) for key in keys))
        return cls(upper, children, parts, even)

    def leaves(self) -> dict[str, Any]:
        upper = prefixed("upper", self.upper.leaves())
        children = prefixed("children", self.children.leaves())
        return {**upper, **children}

    @property
    def widths(self) -> tuple[int, ...]:
        child = jax.tree.map(lambda leaf: leaf[0], self.children)
        return (*self.upper.widths, 0, *child.widths)

    @property
    def unit_counts(self) -> tuple[int, int]:
        return self.upper.unit_counts

    def units(self, odd: Float[Array, " O"], even: Float[Array, " E"]) -> Units:
        above = self.parts[0]
        return self.upper.units(odd[np.array(above.odd, int)], even[np.array(above.even, int)])

    def answers(
        self, units: Units, odd: Float[Array, " O"], even: Float[Array, " E"]
    ) -> Float[Array, " S"]:
        above = self.parts[0]
        odd_above = odd[np.array(above.odd, int)]
        told = self.upper.answers(units, odd_above, even[np.array(above.even, int)])
        split = len(_answers(above, self.even)[0])
        inputs = [_inputs(part, above, self.even) for part in self.parts[1:]]
        odd_seen = _padded(odd, told[:split], [rows for rows, _ in inputs])
        even_seen = _padded(even, told[split:], [rows for _, rows in inputs])

        def answer(child: LinearGlu | Mirrored, odd: Array, even: Array) -> Array:
            return child(odd, even)

        answers = eqx.filter_vmap(answer)(self._weights(), odd_seen, even_seen)
        return reordered(jnp.concatenate([told, answers.ravel()]), self._order(answers.shape[1]))

    def _weights(self) -> LinearGlu | Mirrored:
        """Return the children's networks, one entry per child."""
        rows = self._weight_rows()
        if rows == list(range(len(rows))):
            return self.children
        return jax.tree.map(lambda leaf: leaf[np.array(rows)], self.children)

    def _weight_rows(self) -> list[int]:
        """Return the entry of `children` that holds each child's weights."""
        rows: list[int] = []
        with_own_weights = 0
        for part in self.parts[1:]:
            if part.like < 0:
                rows.append(with_own_weights)
                with_own_weights += 1
            else:
                rows.append(rows[part.like])
        return rows

    def _order(self, width: int) -> Entries:
        """Return the index of each number of the change in (upper answers, children's answers padded to `width`)."""
        odd, even = _answers(self.parts[0], self.even)
        place_of = {entry: place for place, entry in enumerate([*odd, *even])}
        children = [_answers(part, self.even) for part in self.parts[1:]]
        most_odd = max(len(odd) for odd, _ in children)
        start = len(place_of)
        for odd, even in children:
            for number, entry in enumerate(odd):
                place_of[entry] = start + number
            for number, entry in enumerate(even):
                place_of[entry] = start + most_odd + number
            start += width
        return tuple(place_of[entry] for entry in range(len(place_of)))


def _padded(
    stream: Float[Array, " K"], answers: Float[Array, " A"], inputs: list[list[int]]
) -> Float[Array, "G I"]:
    """Return each child's inputs from `stream` and `answers`, padded with zeros.

    `inputs` are those of each child: entries of `stream`, and -1, -2 ... for `answers`.
    """
    size = stream.shape[0]
    width = max(len(entries) for entries in inputs)
    zero = size + answers.shape[0]
    table = np.full((len(inputs), width), zero)
    for child, own in enumerate(inputs):
        for column, entry in enumerate(own):
            if entry >= 0:
                table[child, column] = entry
            else:
                table[child, column] = size - 1 - entry
    source = jnp.concatenate([stream, answers, jnp.zeros(1, stream.dtype)])
    return source.at[table].get(mode="promise_in_bounds")


def check_parts(
    parts: tuple[Part, ...], odd: int, even: int, out: int, widths: tuple[int, ...]
) -> None:
    """Refuse parts that do not answer every number exactly once, or have inputs that do not exist."""
    answered = sorted(entry for part in parts for entry in part.answers)
    if len(parts) < 2 or answered != list(range(out)):
        raise ArgumentError(
            "hierarchy: every number of the change must belong to exactly one of two or more parts."
        )
    if widths.count(0) != 1 or 0 in (widths[0], widths[-1]) or min(widths) < 0:
        raise ArgumentError(
            f"widths: wanted the upper network's layers, 0, a child's layers; got {list(widths)}."
        )
    above = parts[0]
    children = parts[1:]
    for number, part in enumerate(children):
        sees_what_is_there = _are_below(part.odd, odd) and _are_below(part.even, even)
        if not sees_what_is_there or not {*part.hears} <= {*above.answers}:
            raise ArgumentError(
                f"hierarchy: part {quoted(part.name)} refers to an input that does not exist."
            )
        if part.like < 0:
            continue
        if part.like >= number or _shape(part) != _shape(children[part.like]):
            raise ArgumentError(
                f"hierarchy: part {quoted(part.name)} cannot use the weights of part {part.like}."
            )


def _are_below(entries: Entries, size: int) -> bool:
    return all(0 <= entry < size for entry in entries)


def _shape(part: Part) -> tuple[int, ...]:
    return len(part.odd), len(part.even), len(part.answers), len(part.hears)


def parts_to_json(parts: tuple[Part, ...]) -> list[dict[str, Any]]:
    """Return the parts as plain dictionaries."""
    return [asdict(part) for part in parts]


def parts_from_json(rows: Any) -> tuple[Part, ...]:
    """Return the parts that `parts_to_json` wrote; ValueError states what is wrong with them."""
    if not isinstance(rows, list) or len(rows) > MAX_PARTS:
        raise ValueError(f"parts: wanted a list of at most {MAX_PARTS}")
    return tuple(_part_from_json(row) for row in rows)


def _part_from_json(row: Any) -> Part:
    if not isinstance(row, dict):
        raise ValueError("parts: a part is no table")
    name = check_label(row["name"], "parts")
    indices = {}
    for key in ENTRY_KEYS:
        found = entries(row[key], f"parts: {key} of {name}", MAX_NUMBERS)
        indices[key] = found
        if len({*found}) < len(found):
            raise ValueError(f"parts: {key} of {name} names an entry twice")
    like = whole(row["like"], f"parts: like of {name}", -1, MAX_PARTS)
    return Part(name, indices["odd"], indices["even"], indices["answers"], indices["hears"], like)
