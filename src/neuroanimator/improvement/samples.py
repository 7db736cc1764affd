"""What the true physics made of the runs that were chosen: simulated, stored, and cut into windows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from neuroanimator.cores import core_count
from neuroanimator.data.config import MAX_UNROLL
from neuroanimator.data.shard_checks import TensorSpec, check_range, check_tensors, refuse
from neuroanimator.improvement.config import STRETCH
from neuroanimator.improvement.places import Stretches
from neuroanimator.storage.files import read_tensors, write_tensors
from neuroanimator.systems.system import System

KIND = "improvement-samples"
"""What the metadata of a round's file says it is."""

MAX_FILE = 4 * 2**30
"""The largest file of samples that is read [bytes]."""


class Samples(NamedTuple):
    """Runs by the true physics."""

    states: Float[np.ndarray, "N _ S"]
    """(N, T+1, S)"""
    controls: Float[np.ndarray, "N T C"]
    place: Int[np.ndarray, " N"]

    def where(self, mask: Bool[np.ndarray, " N"]) -> Samples:
        """Return the runs `mask` selects."""
        return Samples(self.states[mask], self.controls[mask], self.place[mask])


class Windows(NamedTuple):
    """Windows to learn from; T = H + 1."""

    states: Float[np.ndarray, "N T S"]
    controls: Float[np.ndarray, "N H C"]
    run: Int[np.ndarray, " N"]
    """Which run each comes from."""


def simulated(system: System, stretches: Stretches, dt: float) -> tuple[Samples, np.ndarray]:
    """Return (what the truth makes of `stretches`, which of them diverged (N,))."""
    runs = system.simulate(stretches.starts, stretches.controls, dt, threads=core_count())
    return Samples(runs.states, stretches.controls, stretches.place), runs.has_diverged


def joined(parts: Sequence[Samples]) -> Samples:
    """Return all runs of `parts`, in their order."""
    return Samples(*(np.concatenate(rows) for rows in zip(*parts, strict=True)))


def windows_of(samples: Samples) -> Windows:
    """Return every window of the runs: `MAX_UNROLL` super steps each."""
    firsts = np.arange(samples.controls.shape[1] - MAX_UNROLL + 1)
    steps = firsts[:, None] + np.arange(MAX_UNROLL + 1)
    states = samples.states[:, steps]
    controls = samples.controls[:, steps[:, :-1]]
    count = len(states) * len(firsts)
    return Windows(
        states=states.reshape(count, *states.shape[2:]).astype(np.float32),
        controls=controls.reshape(count, *controls.shape[2:]).astype(np.float32),
        run=np.repeat(np.arange(len(states)), len(firsts)),
    )


def write_samples(path: Path, samples: Samples, identity: str) -> None:
    """Write a round's runs as a whole; `identity` names what they follow from."""
    tensors = {
        "states": samples.states.astype(np.float32),
        "controls": samples.controls.astype(np.float32),
        "place": samples.place.astype(np.int32),
    }
    write_tensors(path, tensors, {"kind": KIND, "identity": identity})


def read_samples(path: Path, system: System, places: int, identity: str) -> Samples:
    """Return a round's runs; BadFileError if the file is damaged or belongs to something else."""
    tensors, metadata = read_tensors(path, KIND, MAX_FILE)
    if metadata.get("identity") != identity:
        refuse(path, "it belongs to another improvement")
    specs = {
        "states": TensorSpec(np.float32, (None, STRETCH + 1, system.state.size)),
        "controls": TensorSpec(np.float32, (None, STRETCH, system.control.size)),
        "place": TensorSpec(np.int32, (None,)),
    }
    check_tensors(path, tensors, specs)
    check_range(path, "place", tensors["place"], 0, places - 1)
    return Samples(tensors["states"], tensors["controls"], tensors["place"])
