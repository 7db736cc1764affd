"""Fit an emulator to transitions; killed and started again it ends with the same bytes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from neuroanimator.codegen.jax_settings import keep_programs
from neuroanimator.emulator.artifact import check_readable, save
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import Network
from neuroanimator.files.atomic import append_line, locked, read_bounded, write_whole
from neuroanimator.files.json_text import parse_json_object
from neuroanimator.files.numbers import number
from neuroanimator.files.places import Place
from neuroanimator.files.unfinished import remove_stale
from neuroanimator.learn.data.store import Dataset
from neuroanimator.learn.training.checkpoint import TrainingState, read_checkpoint, write_checkpoint
from neuroanimator.learn.training.chunk import completed
from neuroanimator.learn.training.config import UPDATES_PER_CHUNK, TrainingConfig
from neuroanimator.learn.training.lesson import Lesson, lesson_of
from neuroanimator.learn.training.loss import squared_error
from neuroanimator.learn.training.optimizer import make_optimizer
from neuroanimator.learn.training.trust_fitting import with_meter
from neuroanimator.learn.training.validation import validation_errors

CHUNKS_PER_REPORT = 4
"""Number of chunks between two validations, lines of metrics and checkpoints."""

SO_FAR = "so-far.emulator.safetensors"
"""Name of the file in a run's folder that holds the best emulator so far, while the training goes on or after it was killed."""

METRICS = "metrics.jsonl"
"""Name of the file of reports in a run's folder."""

Line = TypeVar("Line")
"""Tuple type of a line of `metrics.jsonl`."""

MAX_LINE = 10_000
"""Maximum length of a line of `metrics.jsonl` [characters]; ours have a hundred."""

MAX_METRICS = 50_000_000
"""Maximum size of `metrics.jsonl` [bytes]: that of a hundred million updates."""


class Report(NamedTuple):
    """One line of `metrics.jsonl`."""

    update: int
    loss: float
    error: float
    """Root mean square one-step error on validation runs, over the change's standard deviation."""
    unrolled_error: float
    """The same after the longest unroll."""
    seconds: float
    """Time since this process began training [s]."""


def train(
    data: Dataset,
    config: TrainingConfig,
    out: str | Path,
    *,
    start_from: Emulator | None = None,
    checkpoints: Place | None = None,
    on_report: Callable[[Report], None] = lambda report: None,
    on_chunk: Callable[[int], None] = lambda update: None,
) -> Emulator:
    """Train on `data`, write the best emulator by validation to `out` and return it.

    Checkpoints and `metrics.jsonl` lie in `run_folder(out)`; a run found there is continued. Until it ends, `SO_FAR` there is
    an emulator that moves: the best after one report, two, four, and so on. If another machine may
    have to resume it, `checkpoints` is a folder or URL that both see. It is not locked: two that train the same write the
    same bytes.
    """
    out = Path(out)
    keep_programs()
    folder = run_folder(out)
    with locked(folder):
        run = _Run.prepare(data, config, folder, checkpoints or folder, start_from)
        feed = run.lesson.feed
        remove_stale(folder)
        settings = config.model_dump(mode="json")
        if feed.pools.is_one:  # then the weights do not depend on the memory
            del settings["memory"]
        provenance = {"dataset": data.config.model_dump(), "training": settings}
        check_readable(feed.problem.base, folder, provenance)
        with closing(feed):
            while not run.is_over:
                report = run.advance(on_chunk)
                if run.shows_progress:
                    save(run.known_best, folder / SO_FAR, provenance)
                on_report(report)
        emulator = run.known_best
        save(emulator, out, provenance)
        (folder / SO_FAR).unlink(missing_ok=True)
    return emulator


def run_folder(out: Path) -> Path:
    """Return the folder that holds checkpoints and metrics of the emulator, or the policy, at `out`."""
    return out.with_name(out.name.removesuffix(".safetensors") + ".run")


@dataclass
class _Run:
    """A training run between two reports."""

    lesson: Lesson
    noise: Float[np.ndarray, " S"] | None
    """Standard deviation of the noise in recorded states, if it is known."""
    folder: Path
    checkpoints: Place
    progress: TrainingState
    began: float = field(default_factory=time.monotonic)
    """Time at which this process began to train [s]."""

    @classmethod
    def prepare(
        cls,
        data: Dataset,
        config: TrainingConfig,
        folder: Path,
        checkpoints: Place,
        start_from: Emulator | None,
    ) -> _Run:
        """Return the run in `folder`, resumed if there are `checkpoints` of it."""
        lesson = lesson_of(data, config, start_from)
        fresh = TrainingState.fresh(lesson.problem.base.network, make_optimizer(config))
        progress = read_checkpoint(checkpoints, lesson.fingerprint, fresh)
        trim_metrics(folder, progress.chunk * UPDATES_PER_CHUNK)
        return cls(lesson, data.noise, folder, checkpoints, progress)

    @property
    def is_over(self) -> bool:
        """Whether every update is done, or too many reports have passed without a better network."""
        config = self.lesson.problem.config
        return self.progress.chunk >= config.chunks or self.progress.stale >= config.patience

    @property
    def shows_progress(self) -> bool:
        """Whether the number of reports so far is a power of two, and more follow: often enough to look, at little cost."""
        reports = self.progress.chunk // CHUNKS_PER_REPORT
        return reports.bit_count() == 1 and not self.is_over

    @property
    def known_best(self) -> Emulator:
        """Emulator with the lowest validation error so far, with its trust meter and its validation errors."""
        known = with_meter(self._with(self.progress.best), self.lesson.measured)
        states, controls = map(np.asarray, self.lesson.validation)
        return replace(known, validation=validation_errors(known, states, controls, self.noise))

    def _with(self, network: Network) -> Emulator:
        problem = self.lesson.problem
        return completed(problem.base, network, problem.rest)

    def advance(self, on_chunk: Callable[[int], None]) -> Report:
        """Train until the next report, then validate, log and checkpoint."""
        config = self.lesson.problem.config
        progress = self.progress
        losses = []
        while True:
            network, optimizer_state, loss = self.lesson.feed.train(
                progress.network, progress.optimizer_state, progress.chunk
            )
            losses.append(loss)
            progress = progress._replace(
                network=network, optimizer_state=optimizer_state, chunk=progress.chunk + 1
            )
            on_chunk(progress.chunk * UPDATES_PER_CHUNK)
            if progress.chunk % CHUNKS_PER_REPORT == 0 or progress.chunk >= config.chunks:
                break
        errors = self._validation_errors(progress.network)
        self.progress = progress.judged(float(errors[-1]))
        report = Report(
            update=progress.chunk * UPDATES_PER_CHUNK,
            loss=float(np.mean(losses)),
            error=float(errors[0]),
            unrolled_error=float(errors[-1]),
            seconds=time.monotonic() - self.began,
        )
        append_line(self.folder / METRICS, json.dumps(report._asdict()))
        write_checkpoint(self.checkpoints, self.lesson.fingerprint, self.progress)
        return report

    def _validation_errors(self, network: Network) -> Float[np.ndarray, " H"]:
        """Return the root mean square error after 1..H super steps, over all numbers that move."""
        emulator = self._with(network)
        squares = _squared_error(emulator, *self.lesson.validation)
        moves = np.asarray(self.lesson.problem.base.normaliser.unit) > 0
        return np.sqrt(np.asarray(squares)[:, moves].mean(axis=1))


_squared_error = eqx.filter_jit(squared_error)


def read_metrics(path: Path) -> list[Report]:
    """Return the reports in `metrics.jsonl` of a training at `path`; see `read_reports`."""
    return read_reports(path, Report)


def read_reports(path: Path, kind: Callable[..., Line]) -> list[Line]:
    """Return the reports in `metrics.jsonl` at `path`, in order; none without a file.

    `kind` is a tuple of named numbers. BadFileError if the file is longer than that of any training.
    """
    reports = []
    for told in _numbers_told(path):
        with suppress(TypeError):
            reports.append(kind(**told))
    return reports


def trim_metrics(folder: Path, update: int) -> None:
    """Drop the lines that a killed run logged after its last checkpoint."""
    path = folder / METRICS
    logged = [told for told in _numbers_told(path) if told.get("update", np.inf) <= update]
    if path.exists():
        write_whole(path, "".join(f"{json.dumps(told)}\n" for told in logged).encode())


def _numbers_told(path: Path) -> list[dict[str, float]]:
    """Return the numbers in each line of `metrics.jsonl` at `path`; none without a file. Torn lines are left out."""
    if not path.exists():
        return []
    rows = []
    for line in read_bounded(path, MAX_METRICS).decode(errors="replace").splitlines():
        with suppress(ValueError):
            told = parse_json_object(line, MAX_LINE)
            for name, value in told.items():
                number(value, name)
            rows.append(told)
    return rows
