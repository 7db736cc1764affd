"""What is written by hand as the limit of generated C does what the shipped emulators do."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.super_steps import by_hand
from neuroanimator import load_emulator
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.errors import ResourceError

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


@pytest.mark.parametrize("system", ["pendulum", "fish"])
def test_c_by_hand_is_the_emulator(system: str):
    emulator = load_emulator(f"{system}-50")
    program = by_hand.written_by_hand(emulator)  # it has been held against JAX
    assert program is not None
    for array in program.weights:
        array *= np.float32(1.02)
    with pytest.raises(ResourceError, match="by hand is"):
        by_hand._check(emulator, program)
