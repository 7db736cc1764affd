"""The products of a super step alone, as float32 from where its weights lie: the least that a super step can take."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

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
from runtimes_cases.case import BATCH_STEPS, BATCHES, STEPS, SUPER_STEP, Case, Motion, batch_task

NAME = "products alone"

SIDE_BY_SIDE = 8
"""Sums that are added to side by side, as `roofline.c` has it."""


def cases(motion: Motion) -> Iterator[Case]:
    """Yield the products of one motion, and of sixteen side by side."""
    text = (Path(__file__).parent / "roofline.c").read_text(encoding="utf-8")
    library = compiled_library(prelude() + text, FLAGS)
    if library is None:
        raise ResourceError("runtimes: nothing can be compiled here. Install a C compiler.")
    products = products_of(motion.emulator)
    blocks = -(-products // (SIDE_BY_SIDE * WIDTH))
    panels = -(-products // (WIDTH * WIDTH))
    weights = lanes(panels * WIDTH)
    one = lanes(1)
    alone = partial(library.products, _at(weights), ctypes.c_long(blocks), ctypes.c_long(STEPS))
    yield Case(NAME, SUPER_STEP, STEPS, partial(alone, _at(one)))
    x = lanes(WIDTH)
    y = lanes(panels * WIDTH)
    for batch in BATCHES:
        steps = batch * BATCH_STEPS
        together = partial(
            library.products_of_lanes,
            _at(weights),
            _at(x),
            ctypes.c_long(panels),
            ctypes.c_long(steps // WIDTH),
            _at(y),
        )
        yield Case(NAME, batch_task(batch), steps, together)


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
