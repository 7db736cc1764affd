"""The products of a super step alone, from where its weights lie: the least that a super step can take."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.super_steps.case import (
    BATCH_STEPS,
    BATCHES,
    STEPS,
    SUPER_STEP,
    Case,
    Motion,
    batch_task,
)
from neuroanimator.codegen.c_function import prelude
from neuroanimator.codegen.c_map import lanes
from neuroanimator.codegen.c_text import are_weights
from neuroanimator.codegen.compiler import compiled_library
from neuroanimator.codegen.kept import FLAGS
from neuroanimator.codegen.program import WIDTH
from neuroanimator.codegen.trace import Input, trace
from neuroanimator.emulator.c_emulator import super_step
from neuroanimator.emulator.super_step import SuperStep, latent_size
from neuroanimator.errors import ResourceError

NAME = "products alone"

PAIRS = {"products of bfloat16 alone": "_bfloat16", "products of int16 alone": "_int16"}
"""Runtimes with weights and inputs of 16 bits, and how the names of their functions in `roofline.c` end."""

TILES = "products of bfloat16 in tiles alone"

SIDE_BY_SIDE = 8
"""Sums that are added to side by side, as `roofline.c` has it."""


def cases(motion: Motion) -> Iterator[Case]:
    """Yield the products of one motion, and of motions side by side; also of 16 bits, where the processor has them."""
    text = (Path(__file__).parent / "roofline.c").read_text(encoding="utf-8")
    library = compiled_library(prelude() + text, FLAGS)
    if library is None:
        raise ResourceError("runtimes: nothing can be compiled here. Install a C compiler.")
    yield from _products(motion, library, NAME, "", weights_per_float=1)
    if hasattr(library, "products_bfloat16"):
        for name, suffix in PAIRS.items():
            yield from _products(motion, library, name, suffix, weights_per_float=2)
    if hasattr(library, "has_tiles") and library.has_tiles():
        yield from _products_of_lanes(motion, library, TILES, "_tiles", weights_per_float=2)


def _products(
    motion: Motion, library: ctypes.CDLL, name: str, suffix: str, weights_per_float: int
) -> Iterator[Case]:
    """Yield products by the functions of `roofline.c` whose names end with `suffix`."""
    blocks = _blocks(motion, SIDE_BY_SIDE * WIDTH * weights_per_float)
    weights = lanes(blocks * SIDE_BY_SIDE)
    one = lanes(1)
    function = library[f"products{suffix}"]
    sizes = ctypes.c_long(blocks), ctypes.c_long(STEPS)
    yield Case(name, SUPER_STEP, STEPS, partial(function, _at(weights), *sizes, _at(one)))
    yield from _products_of_lanes(motion, library, name, suffix, weights_per_float)


def _products_of_lanes(
    motion: Motion, library: ctypes.CDLL, name: str, suffix: str, weights_per_float: int
) -> Iterator[Case]:
    """Yield the products of each batch, sixteen motions side by side."""
    panels = _blocks(motion, WIDTH * WIDTH * weights_per_float)
    weights = lanes(panels * WIDTH)
    x = lanes(WIDTH)
    y = lanes(panels * WIDTH)
    function = library[f"products_of_lanes{suffix}"]
    for batch in BATCHES:
        steps = batch * BATCH_STEPS
        sizes = ctypes.c_long(panels), ctypes.c_long(steps // WIDTH)
        together = partial(function, _at(weights), _at(x), *sizes, _at(y))
        yield Case(name, batch_task(batch), steps, together)


def _blocks(motion: Motion, products: int) -> int:
    """Return the number of blocks of so many products that hold all of a super step."""
    return -(-products_of(motion.emulator) // products)


def products_of(emulator: SuperStep) -> int:
    """Return the number of products of weights in a super step."""
    inputs = [Input((latent_size(emulator),)), Input((emulator.control.size,))]
    program = trace(super_step, emulator, *inputs)
    count = 0
    for operation in program.operations:
        if operation.name == "dot_general":
            weights = [one for one in operation.inputs if are_weights(program, one)]
            count += sum(matrix.size for matrix in weights)
    return count


def _at(array: np.ndarray) -> ctypes.c_void_p:
    """Return where an array lies, which lives as long."""
    return array.ctypes.data_as(ctypes.c_void_p)
