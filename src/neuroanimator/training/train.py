"""Fit an emulator to transitions; killed and started again it ends with the same bytes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from neuroanimator.data.store import Transitions
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.artifact import check_readable, save
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.tensors import emulator_tensors
from neuroanimator.errors import ArgumentError
from neuroanimator.parsing.json_text import parse_json_object
from neuroanimator.state.symmetry import Symmetry
from neuroanimator.storage.files import append_line, digest, locked, write_whole
from neuroanimator.storage.program_cache import keep_programs
from neuroanimator.storage.unfinished import remove_stale
from neuroanimator.systems.system import System
from neuroanimator.training.batches import rare_rows
from neuroanimator.training.checkpoint import Progress, read_checkpoint, write_checkpoint
from neuroanimator.training.chunk import TrainingProblem, completed, train_chunk
from neuroanimator.training.config import UPDATES_PER_CHUNK, TrainingConfig
from neuroanimator.training.initialise import build_emulator
from neuroanimator.training.loss import squared_error
from neuroanimator.training.optimizer import make_optimizer

CHUNKS_PER_REPORT = 4
"""Chunks between two validations, lines of metrics and checkpoints."""

MAX_LINE = 10_000
"""Longest line of `metrics.jsonl` that is read [characters]; ours have a hundred."""

MAX_VALIDATION = 8192
"""Windows used for validation, at most: more would slow training and change no digit that matters."""


STILL = 0.01
"""Share of a usual change by which a system at rest may move in a super step and still count as keeping still."""


class Report(NamedTuple):
    """One line of `metrics.jsonl`."""

    update: int
    loss: float
    error: float
    """Root mean square one-step error on validation runs, over the change's standard deviation."""
    unrolled_error: float
    """The same after the longest unroll."""
    seconds: float
    """Since this process began training [s]."""


def train(
    data: Transitions,
    config: TrainingConfig,
    out: str | Path,
    *,
    start_from: Emulator | None = None,
    on_report: Callable[[Report], None] = lambda report: None,
) -> Emulator:
    """Train on `data`, write the best emulator by validation to `out` and return it.

    Checkpoints and `metrics.jsonl` lie in `run_folder(out)`; a run found there is continued.
    """
    out = Path(out)
    keep_programs()
    folder = run_folder(out)
    with locked(folder):
        run = _Run.prepare(data, config, folder, start_from)
        remove_stale(folder)
        provenance = {
            "dataset": data.config.model_dump(),
            "training": config.model_dump(mode="json"),
        }
        check_readable(run.problem.base, folder, provenance)
        while not run.is_over:
            on_report(run.advance())
        emulator = run.best
        save(emulator, out, provenance)
    return emulator


def run_folder(out: Path) -> Path:
    """Return the folder that holds checkpoints and metrics of the emulator at `out`."""
    return out.with_name(out.name.removesuffix(".safetensors") + ".run")


@dataclass
class _Run:
    """A training run between two reports."""

    problem: TrainingProblem
    validation_states: Float[Array, "N T I"]
    validation_controls: Float[Array, "N H C"]
    folder: Path
    fingerprint: str
    """Names the data, the settings and the emulator the run began with."""
    progress: Progress
    began: float = field(default_factory=time.monotonic)
    """When this process began to train [s]."""

    @classmethod
    def prepare(
        cls, data: Transitions, config: TrainingConfig, folder: Path, start_from: Emulator | None
    ) -> _Run:
        """Return the run in `folder`, where it stopped if it was begun."""
        is_held_out = validation_mask(data.run, config)
        if not is_held_out.any() or is_held_out.all():
            raise ArgumentError(_too_few(data))
        base = start_from or build_emulator(data.where(~is_held_out), config)
        training = base_windows(base, data.where(~is_held_out))
        validation = base_windows(base, data.where(is_held_out))
        rest = None
        if keeps_still(data.system, base):
            rest = base.rest_streams()
        problem = TrainingProblem(
            config=config,
            structure=data.system.structure,
            symmetries=found_symmetries(data),
            base=base,
            states=as_jax(training.states),
            controls=as_jax(training.controls),
            rare=as_jax(rare_rows(base, training), np.int32),
            rest=rest,
        )
        fingerprint = f"{_content_hash(data, base)}-{config.hash}"
        fresh = Progress.fresh(base.network, make_optimizer(config))
        progress = read_checkpoint(folder, fingerprint, fresh)
        _trim_metrics(folder, progress.chunk * UPDATES_PER_CHUNK)
        return cls(
            problem=problem,
            validation_states=as_jax(validation.states[:MAX_VALIDATION]),
            validation_controls=as_jax(validation.controls[:MAX_VALIDATION]),
            folder=folder,
            fingerprint=fingerprint,
            progress=progress,
        )

    @property
    def is_over(self) -> bool:
        """Whether every update is done, or too many reports went by without a better network."""
        config = self.problem.config
        return self.progress.chunk >= config.chunks or self.progress.stale >= config.patience

    @property
    def best(self) -> Emulator:
        """The emulator with the lowest validation error so far."""
        return completed(self.problem.base, self.progress.best, self.problem.rest)

    def advance(self) -> Report:
        """Train until the next report, then validate, log and checkpoint."""
        config = self.problem.config
        progress = self.progress
        losses = []
        while True:
            network, optimizer_state, loss = train_chunk(
                self.problem,
                progress.network,
                progress.optimizer_state,
                as_jax(progress.chunk, np.int32),
                config.unroll_at(progress.chunk),
            )
            losses.append(float(loss))
            progress = progress._replace(
                network=network, optimizer_state=optimizer_state, chunk=progress.chunk + 1
            )
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
        append_line(self.folder / "metrics.jsonl", json.dumps(report._asdict()))
        write_checkpoint(self.folder, self.fingerprint, self.progress)
        return report

    def _validation_errors(self, network: Network) -> Float[np.ndarray, " H"]:
        """Return the root mean square error after 1..H super steps, of all numbers that move."""
        emulator = completed(self.problem.base, network, self.problem.rest)
        squares = _validate(emulator, self.validation_states, self.validation_controls)
        moves = np.asarray(self.problem.base.normaliser.unit) > 0
        return np.sqrt(np.asarray(squares)[:, moves].mean(axis=1))


def _too_few(data: Transitions) -> str:
    """Return what is said of data that cannot be parted into some to learn from and some to validate by."""
    lost = ""
    if data.diverged:
        lost = f" {data.diverged} runs diverged and were dropped: use a smaller step."
    return f"count: {len(data.run)} transitions are too few to train on; wanted some hundred.{lost}"


def _content_hash(data: Transitions, base: Emulator) -> str:
    """Return sixteen hex digits that name the windows and every number of the emulator training starts from."""
    contents = {"states": data.states, "controls": data.controls, **emulator_tensors(base)}
    return digest(contents)[:16]


def keeps_still(system: System, emulator: Emulator) -> bool:
    """Return whether the physics stays where it is at rest without control, measured over one super step.

    Of recordings and functions of a user's nobody asks: they may be there, or be allowed to run, or not, and what is
    trained must not depend on that.
    """
    if not system.is_self_contained:
        return False
    rest = system.rest[None]
    idle = np.tile(system.bounds.idle, (1, 1, 1))
    after = system.simulate(rest, idle, emulator.dt).states[:, -1]
    before_latent = emulator.encode(np.asarray(rest, float))
    after_latent = emulator.encode(np.asarray(after, float))
    moved = np.abs(emulator.frame.difference(before_latent, after_latent)[0])
    return bool((moved <= STILL * np.asarray(emulator.normaliser.unit)).all())


def found_symmetries(data: Transitions) -> tuple[Symmetry, ...]:
    """Return the symmetries of the system, tried on some of `data`.

    As with `keeps_still`, only physics of our own is asked.
    """
    if not data.system.is_self_contained:
        return ()
    return data.system.symmetries(data.states[:, 0], data.controls[:, 0])


def base_windows(base: Emulator, data: Transitions) -> Transitions:
    """Return the windows in the latent numbers in which `base` makes its super steps."""
    states = base.encoding.encode_recorded(data.states)
    controls = base.encode_control(data.controls).astype(np.float32, copy=False)
    return replace(data, states=states, controls=controls)


def validation_mask(run: Int[np.ndarray, " N"], config: TrainingConfig) -> Bool[np.ndarray, " N"]:
    """Return (N,) True for windows whose whole run is kept for validation."""
    runs = np.unique(run)
    count = max(1, round(len(runs) * config.validation_share))
    chosen = np.random.default_rng([config.seed, 1]).permutation(runs)[:count]
    return np.isin(run, chosen)


@eqx.filter_jit
def _validate(
    emulator: Emulator, states: Float[Array, "N T I"], controls: Float[Array, "N H C"]
) -> Float[Array, "H V"]:
    return squared_error(emulator, states, controls)


def _trim_metrics(folder: Path, update: int) -> None:
    """Drop lines a killed run logged after its last checkpoint."""
    path = folder / "metrics.jsonl"
    if not path.exists():
        return
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    logged = [line + "\n" for line in lines if _logged_by(line, update)]
    write_whole(path, "".join(logged).encode())


def _logged_by(line: str, update: int) -> bool:
    """Return whether a line of the metrics was written by update number `update`; false for torn lines."""
    try:
        return parse_json_object(line, MAX_LINE)["update"] <= update
    except (ValueError, KeyError, TypeError):
        return False
