"""Modules are pytrees for JAX, and can be taken apart without it."""

from __future__ import annotations

import subprocess
import sys

import jax
import numpy as np
import pytest

from neuroanimator import Emulator, load_emulator, load_policy
from neuroanimator.pytrees import Module, leaves, map_leaves, static, structure_in_words

LATER = """
import sys
from neuroanimator import load_emulator
emulator = load_emulator("pendulum-50")
assert "jax" not in sys.modules
import jax
from neuroanimator.pytrees import leaves
assert [id(leaf) for leaf in jax.tree.leaves(emulator)] == [id(leaf) for leaf in leaves(emulator)]
"""
"""JAX is imported by somebody else, after the emulator was loaded."""


class Pair(Module):
    left: object
    right: object
    name: str = static(default="a pair")


def trees() -> list[object]:
    nested = Pair([np.zeros(2), None], {"b": np.ones(1), "a": (np.ones(3),)})
    return [nested, load_emulator("truck-50"), load_policy("fish")]


@pytest.mark.parametrize("tree", trees(), ids=["nested", "emulator", "policy"])
def test_leaves_come_in_the_order_jax_knows(tree: object):
    expected = jax.tree.leaves(tree)
    assert len(expected) == len(leaves(tree))
    for leaf, other in zip(leaves(tree), expected, strict=True):
        assert leaf is other


@pytest.mark.parametrize("tree", trees(), ids=["nested", "emulator", "policy"])
def test_what_is_mapped_is_what_jax_maps(tree: object):
    mapped = map_leaves(lambda leaf: leaf + 1, tree)
    expected = jax.tree.map(lambda leaf: leaf + 1, tree)
    assert jax.tree.structure(mapped) == jax.tree.structure(expected)
    for leaf, other in zip(leaves(mapped), leaves(expected), strict=True):
        np.testing.assert_array_equal(leaf, other)


def test_words_tell_structures_apart_and_leave_out_numbers(shipped: Emulator):
    told = structure_in_words(shipped)
    assert told == structure_in_words(map_leaves(np.zeros_like, shipped))
    assert told != structure_in_words(shipped.in_strides(2))
    assert structure_in_words(Pair(1.0, 2.0)) != structure_in_words(Pair(1.0, 2.0, name="another"))
    assert structure_in_words(Pair(1.0, (2.0,))) != structure_in_words(Pair(1.0, [2.0]))


def test_a_module_loaded_before_jax_is_a_pytree_for_it_too():
    subprocess.run([sys.executable, "-c", LATER], check=True, timeout=120)
