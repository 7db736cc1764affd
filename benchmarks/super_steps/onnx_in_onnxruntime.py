"""The ONNX file that users export, in onnxruntime on one thread: one call of Python for each super step, as engines call it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import onnxruntime
from jaxtyping import Float

from benchmarks.super_steps.case import (
    BATCH_STEPS,
    BATCHES,
    STEPS,
    SUPER_STEP,
    Case,
    Motion,
    batch_task,
)

NAME = "onnxruntime"


def cases(motion: Motion, file: Path) -> Iterator[Case]:
    """Yield the cases of the file; ONNX has no gradients."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
    alone = partial(roll_out, session, motion.rest[None], motion.controls[None])
    yield Case(NAME, SUPER_STEP, STEPS, alone)
    for batch in BATCHES:
        together = partial(roll_out, session, *motion.batch(batch))
        yield Case(NAME, batch_task(batch), batch * BATCH_STEPS, together)


def roll_out(
    session: onnxruntime.InferenceSession,
    states: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
) -> None:
    """Make all super steps, one after the other."""
    for held in np.ascontiguousarray(np.moveaxis(controls, 1, 0)):
        (following,) = session.run(["next_state"], {"state": states, "control": held})
        states = np.asarray(following)
