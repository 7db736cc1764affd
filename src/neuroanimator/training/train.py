"""Fit an emulator to transitions; killed and started again it ends with the same bytes."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from neuroanimator.data.store import Transitions
from neuroanimator.emulator.artifact import check_readable, save
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.emulator.networks.network import Network
from neuroanimator.errors import ArgumentError
from neuroanimator.parsing.json_text import parse_json_object
from neuroanimator.state.structure import Structure
from neuroanimator.storage.files import append_line, digest, locked, write_whole
from neuroanimator.storage.program_cache import keep_programs
from neuroanimator.storage.unfinished import remove_stale
from neuroanimator.systems.system import System
from neuroanimator.training.batches import draw_batches, folded, rare_rows
from neuroanimator.training.checkpoint import Progress, read_checkpoint, write_checkpoint
from neuroanimator.training.config import UPDATES_PER_CHUNK, TrainingConfig
from neuroanimator.training.initialise import build_emulator
from neuroanimator.training.loss import squared_error, unrolled_loss
from neuroanimator.training.optimizer import make_optimizer

CHUNKS_PER_REPORT = 4
"""Chunks between two validations, lines of metrics and checkpoints."""

MAX_LINE = 10_000
"""Of `metrics.jsonl` [characters]; ours have a hundred."""

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
    out: Path,
    *,
    start_from: Emulator | None = None,
    on_report: Callable[[Report], None] = lambda report: None,
) -> Emulator:
    """Train on `data`, write the best emulator by validation to `out` and return it.

    Checkpoints and `metrics.jsonl` lie in `run_folder(out)`; a run found there is continued.
    """
    keep_programs()
    folder = run_folder(out)
    with locked(folder):
        run = _Run.prepare(data, config, folder, start_from)
        remove_stale(folder)
        provenance = {
            "dataset": data.config.model_dump(),
            "training": config.model_dump(mode="json"),
        }
        check_readable(run.base, folder, provenance)
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

    config: TrainingConfig
    folder: Path
    base: Emulator
    progress: Progress
    training: tuple[Array, Array]
    structure: Structure
    rare: Array
    """Rows of `training` with the most unusual changes."""
    rest: RestStreams | None
    """What the network sees at rest; None where the system does not keep still there."""
    validation: tuple[Array, Array]
    fingerprint: str
    began: float = field(default_factory=time.monotonic)

    @classmethod
    def prepare(
        cls, data: Transitions, config: TrainingConfig, folder: Path, start_from: Emulator | None
    ) -> _Run:
        held_out = validation_mask(data.run, config)
        if not held_out.any() or held_out.all():
            lost = (
                f" {data.diverged} runs diverged and were dropped: use a smaller step."
                if data.diverged
                else ""
            )
            raise ArgumentError(
                f"count: {len(data.run)} transitions are too few to train on; wanted some hundred.{lost}"
            )
        learn, check = data.where(~held_out), data.where(held_out)
        base = start_from or build_emulator(learn, config)
        learn, check = base_windows(base, learn), base_windows(base, check)
        contents = {"states": data.states, "controls": data.controls, "network": _first_leaf(base)}
        fingerprint = f"{digest(contents)[:16]}-{config.hash}"
        fresh = Progress.fresh(base.network, make_optimizer(config))
        progress = read_checkpoint(folder, fingerprint, fresh)
        _trim_metrics(folder, progress.chunk * UPDATES_PER_CHUNK)
        few = slice(MAX_VALIDATION)
        training = jnp.asarray(learn.states), jnp.asarray(learn.controls)
        validation = jnp.asarray(check.states[few]), jnp.asarray(check.controls[few])
        rare = jnp.asarray(rare_rows(base, learn))
        rest = base.rest_streams() if keeps_still(data.system, base) else None
        return cls(
            config,
            folder,
            base,
            progress,
            training,
            data.system.structure,
            rare,
            rest,
            validation,
            fingerprint,
        )

    @property
    def is_over(self) -> bool:
        return (
            self.progress.chunk >= self.config.chunks or self.progress.stale >= self.config.patience
        )

    @property
    def best(self) -> Emulator:
        return with_network(self.base, self.progress.best, self.rest)

    def advance(self) -> Report:
        """Train until the next report, then validate, log and checkpoint."""
        progress, losses = self.progress, []
        while True:
            network, state, loss = _train_chunk(
                self.config, self.structure, self.base, progress.network, progress.optimizer_state, *self.training,
                self.rare, self.rest, jnp.asarray(progress.chunk), self.config.unroll_at(progress.chunk),
            )  # fmt: skip
            losses.append(float(loss))
            progress = progress._replace(
                network=network, optimizer_state=state, chunk=progress.chunk + 1
            )
            if progress.chunk % CHUNKS_PER_REPORT == 0 or progress.chunk >= self.config.chunks:
                break
        moves = np.asarray(self.base.normaliser.unit) > 0
        emulator = with_network(self.base, progress.network, self.rest)
        by_step = np.sqrt(_validate(emulator, *self.validation)[:, moves].mean(axis=1))
        self.progress = progress.judged(float(by_step[-1]))
        seconds = time.monotonic() - self.began
        update = progress.chunk * UPDATES_PER_CHUNK
        report = Report(
            update, float(np.mean(losses)), float(by_step[0]), float(by_step[-1]), seconds
        )
        append_line(self.folder / "metrics.jsonl", json.dumps(report._asdict()))
        write_checkpoint(self.folder, self.fingerprint, self.progress)
        return report


RestStreams = tuple[Array, Array]
"""See `Emulator.rest_streams`."""


def with_network(base: Emulator, network: Network, rest: RestStreams | None) -> Emulator:
    """Return `base` with another network, and, given what that sees at rest, at rest there."""
    emulator = eqx.tree_at(lambda emulator: emulator.network, base, network)
    return emulator if rest is None else emulator.at_rest(rest)


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
    latent = [emulator.encode(np.asarray(states, float)) for states in (rest, after)]
    moved = np.abs(emulator.frame.difference(*latent)[0])
    return bool((moved <= STILL * np.asarray(emulator.normaliser.unit)).all())


def base_windows(base: Emulator, data: Transitions) -> Transitions:
    """Return the windows in the latent numbers in which `base` makes its super steps."""
    states = base.encoding.encode_recorded(data.states)
    controls = base.encode_control(data.controls).astype(np.float32, copy=False)
    return replace(data, states=states, controls=controls)


def validation_mask(run: np.ndarray, config: TrainingConfig) -> np.ndarray:
    """Return (N,) True for windows whose whole run is kept for validation."""
    runs = np.unique(run)
    chosen = np.random.default_rng([config.seed, 1]).permutation(runs)[
        : max(1, round(len(runs) * config.validation_share))
    ]
    return np.isin(run, chosen)


@eqx.filter_jit
def _train_chunk(
    config: TrainingConfig,
    structure: Structure,
    base: Emulator,
    network: Network,
    optimizer_state: Any,
    states: Float[Array, "N H+1 S"],
    controls: Float[Array, "N H C"],
    rare: Array,
    rest: RestStreams | None,
    chunk: Array,  # an array: a plain int would be compiled in, and every chunk compiled anew
    unroll: int,
) -> tuple[Network, Any, Float[Array, ""]]:
    """Return (network, optimiser state, mean loss) after one chunk of updates.

    Batches follow from the seed and the chunk's number alone, so that a resumed run sees the same.
    """
    optimizer = make_optimizer(config)
    size = max(1, config.batch // unroll)
    key = jax.random.fold_in(jax.random.key(config.seed), chunk)
    batches, weights = draw_batches(key, size, states.shape[0], rare, config.rare_share)

    def loss_of(network: Network, rows: Array) -> Array:
        emulator = with_network(base, network, rest)
        of_rows = None if weights is None else weights[rows]
        windows = states[rows, : unroll + 1], controls[rows, :unroll]
        if structure.symmetry_order > 1:
            windows = folded(structure, base.frame, jax.random.fold_in(key, rows[0]), *windows)
        return unrolled_loss(emulator, *windows, of_rows)

    def update(carry, rows):
        network, optimizer_state = carry
        loss, gradient = jax.value_and_grad(loss_of)(network, rows)
        step, optimizer_state = optimizer.update(gradient, optimizer_state, network)
        return (eqx.apply_updates(network, step), optimizer_state), loss

    (network, optimizer_state), losses = jax.lax.scan(update, (network, optimizer_state), batches)
    return network, optimizer_state, losses.mean()


def time_chunk(emulator: Emulator, config: TrainingConfig) -> float:
    """Return how long one chunk of single-step updates takes here [s], compilation excluded."""
    rng, spec = np.random.default_rng(0), emulator.spec
    rest = jnp.asarray(spec.rest, jnp.float32)
    states = emulator.encode(
        rest + 1e-3 * rng.normal(size=(1024, 2, spec.state.size)).astype(np.float32)
    )
    controls = jnp.tile(jnp.asarray(spec.bounds.middle, jnp.float32), (1024, 1, 1))
    fresh = Progress.fresh(emulator.network, make_optimizer(config))
    spans = []
    for chunk in range(3):
        began = time.perf_counter()
        inputs = (
            fresh.network,
            fresh.optimizer_state,
            states,
            controls,
            jnp.arange(64),
            None,
            jnp.asarray(chunk),
            1,
        )
        jax.block_until_ready(_train_chunk(config, Structure((), (), ()), emulator, *inputs))
        spans.append(time.perf_counter() - began)
    return min(spans[1:])


@eqx.filter_jit
def _validate(emulator: Emulator, states: Array, controls: Array) -> Array:
    return squared_error(emulator, states, controls)


def _first_leaf(base: Emulator) -> np.ndarray:
    return np.asarray(jax.tree.leaves(base.network)[0])


def _trim_metrics(folder: Path, update: int) -> None:
    """Drop lines a killed run logged after its last checkpoint."""
    path = folder / "metrics.jsonl"
    if path.exists():
        lines = [
            line
            for line in path.read_text(encoding="utf-8", errors="replace").splitlines()
            if _logged_by(line, update)
        ]
        write_whole(path, "".join(line + "\n" for line in lines).encode())


def _logged_by(line: str, update: int) -> bool:
    try:
        return parse_json_object(line, MAX_LINE)["update"] <= update
    except (ValueError, KeyError, TypeError):
        return False
