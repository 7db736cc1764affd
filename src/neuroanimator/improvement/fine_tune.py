"""Train an emulator on with a recording of the true thing, keeping what it knew by simulated motions among it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from neuroanimator.data.config import MAX_UNROLL, DatasetConfig
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import BadFileError
from neuroanimator.evaluation.held_out import (
    HeldOut,
    make_test,
    recorded_runs,
    system_of,
)
from neuroanimator.improvement.config import ImprovementConfig
from neuroanimator.improvement.improve import PlaceError, fresh_data, usual_test
from neuroanimator.improvement.learning import error_on
from neuroanimator.improvement.mixture import mixed, only_new, warm_config, widened
from neuroanimator.improvement.recordings import RecordedRuns, read_runs
from neuroanimator.improvement.samples import Windows
from neuroanimator.systems.system import System
from neuroanimator.terminal import phase
from neuroanimator.training.train import Report, train

TAIL = 0.2
"""Share at the end of each run that is kept for the test."""

RECORDED_SHARE = 0.5
"""Share of what is learnt that was recorded: it contradicts what was simulated, so that it needs a larger one than new
simulated windows do."""

MIN_WINDOWS = 100
"""A recording must have so many windows to learn from: fewer teach nothing that lasts."""

MAX_WINDOWS = 100_000
"""So many windows of a recording are learnt from, at most, evenly taken."""

MAX_TESTED = 8_000
"""So many super steps of its tail are tested, at most, evenly taken."""

BLOCK = 8
"""Windows that begin within so many super steps are validated on together, or learnt from together: they overlap."""


@dataclass(frozen=True)
class FineTuning:
    """What came of it."""

    emulator: Emulator
    errors: tuple[PlaceError, ...]
    """On the recording's tail, which was not learnt from, and on usual motions where there is a test of these."""
    windows: int
    """Windows of the recording that were learnt from."""
    has_old: bool
    """Whether what was known was among what was learnt."""


class _Parts(NamedTuple):
    """A recording, cut into what is learnt from and what is tested."""

    learning: Windows
    states: Float[np.ndarray, "M 2 S"]
    controls: Float[np.ndarray, "M 1 C"]


def fine_tune(
    emulator: Emulator,
    recording: str | Path,
    out: str | Path,
    *,
    config: ImprovementConfig | None = None,
    data: Transitions | None = None,
    on_report: Callable[[Report], None] = lambda report: None,
) -> FineTuning:
    """Train `emulator` on with a recording (CSV or NPZ), write it to `out` and return what came of it.

    The last fifth of each run is its test and never learnt from. Half of what is learnt are old windows: those of
    `data`, or simulated anew where the system can be. Nothing is simulated besides; of `config` only the updates, the
    windows and the seed count. A run found in `run_folder(out)` is continued.

    Raises BadFileError naming the line of a recording that is wrong, and for one that is too short.
    """
    config = config or ImprovementConfig()
    system = system_of(emulator)
    runs = read_runs(recording, emulator)
    parts = _cut(runs, emulator)
    tail = make_test(system, emulator.dt, parts.states, parts.controls)
    if data is None and system.can_simulate:
        with phase("simulating what it knows"):
            data = fresh_data(emulator, config)
    tests = {str(recording): tail}
    usual = _usual_test(emulator, system, data, config.seed)
    if usual is not None:
        tests["usual"] = usual
    before = _errors(emulator, tests)
    if data is None:
        windows = only_new(_dataset(emulator), system, parts.learning, config)
    else:
        windows = mixed(data, parts.learning, config, RECORDED_SHARE)
    trained = train(
        windows,
        warm_config(emulator, system.structure, config.updates, config.seed),
        Path(out),
        start_from=widened(emulator, parts.learning),
        on_report=on_report,
    )
    after = _errors(trained, tests)
    told = tuple(PlaceError(name, before[name], after[name]) for name in tests)
    return FineTuning(trained, told, len(parts.learning.states), data is not None)


def _errors(emulator: Emulator, tests: dict[str, HeldOut]) -> dict[str, float]:
    """Return the 95th percentile of one-step errors on each test."""
    return {name: error_on(emulator, test) for name, test in tests.items()}


def _usual_test(
    emulator: Emulator, system: System, data: Transitions | None, seed: int
) -> HeldOut | None:
    """Return a test of what the emulator knew; None where nobody can say."""
    if system.can_simulate:
        with phase("simulating tests"):
            return usual_test(emulator, system, seed)
    if data is None:
        return None
    return recorded_runs(emulator, data)


def _dataset(emulator: Emulator) -> DatasetConfig:
    """Return what stands for the dataset of an emulator whose own is not at hand."""
    return DatasetConfig(
        system=emulator.system, definition=emulator.definition, substeps=emulator.substeps
    )


def _cut(runs: RecordedRuns, emulator: Emulator) -> _Parts:
    """Return what is learnt from and what is tested: the last fifth of each run, which shares no sample with the rest."""
    length = MAX_UNROLL * runs.substeps
    states = []
    controls = []
    blocks = []
    test_states = []
    test_controls = []
    block = 0
    for run_states, run_controls in zip(runs.states, runs.controls, strict=True):
        cut = len(run_states) - round(TAIL * len(run_states))
        firsts = np.arange(max(0, cut - length))
        states.append(_super_states(run_states, firsts, runs.substeps, MAX_UNROLL))
        controls.append(_held(run_controls, firsts, runs.substeps, MAX_UNROLL))
        blocks.append(block + firsts // (BLOCK * runs.substeps))
        block += len(run_states) // (BLOCK * runs.substeps) + 1
        tested = np.arange(cut, len(run_states) - runs.substeps)
        test_states.append(_super_states(run_states, tested, runs.substeps, 1))
        test_controls.append(_held(run_controls, tested, runs.substeps, 1))
    learning = Windows(np.concatenate(states), np.concatenate(controls), np.concatenate(blocks))
    tail_states = np.concatenate(test_states)
    if len(learning.states) < MIN_WINDOWS or not len(tail_states):
        wanted = round((MIN_WINDOWS + length) / (1 - TAIL)) + 1
        raise BadFileError(
            f"{runs.file}: {len(learning.states)} windows to learn from and {len(tail_states)} super steps to test on; "
            f"wanted a run of at least {max(wanted, round(2 * runs.substeps / TAIL)):,} rows. Record longer."
        )
    taken = slice(None, None, -(-len(learning.states) // MAX_WINDOWS))
    tested = slice(None, None, -(-len(tail_states) // MAX_TESTED))
    return _Parts(
        Windows(
            learning.states[taken].astype(np.float32),
            learning.controls[taken].astype(np.float32),
            learning.run[taken],
        ),
        tail_states[tested],
        np.concatenate(test_controls)[tested],
    )


def _super_states(
    states: Float[np.ndarray, "T S"], firsts: Int[np.ndarray, " N"], substeps: int, count: int
) -> Float[np.ndarray, "N _ S"]:
    """Return (N, count+1, S): the states from each of `firsts` on, a super step apart."""
    return states[firsts[:, None] + substeps * np.arange(count + 1)]


def _held(
    controls: Float[np.ndarray, "T C"], firsts: Int[np.ndarray, " N"], substeps: int, count: int
) -> Float[np.ndarray, "N H C"]:
    """Return the mean control over each of `count` super steps from each of `firsts` on."""
    steps = firsts[:, None] + np.arange(count * substeps)
    return controls[steps].reshape(len(firsts), count, substeps, controls.shape[1]).mean(axis=2)
