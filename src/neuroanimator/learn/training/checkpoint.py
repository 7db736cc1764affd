"""Checkpoints of a training run, on disk or in an object store."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import optax

from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.tensors import checked_arrays, to_numpy
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import SIZE_LIMIT, read_tensors, write_tensors
from neuroanimator.files.numbers import number, whole
from neuroanimator.files.places import Place

Numbers = TypeVar("Numbers")

NAME = "checkpoint.safetensors"

MAX_CHUNKS = 2**31 - 1
"""Maximum number of chunks, which JAX counts in 32 bits."""


WORST_ERROR = 1e30
"""Validation error before the first validation, as JSON has no infinity; any real one is lower."""


class TrainingState(NamedTuple):
    """Everything the rest of a run depends on."""

    network: Network
    optimizer_state: Any
    best: Network
    """Network with the lowest validation error so far."""
    best_error: float
    chunk: int
    """Number of chunks done."""
    stale: int
    """Number of reports since the best one."""

    @classmethod
    def fresh(cls, network: Network, optimizer: optax.GradientTransformation) -> TrainingState:
        """Return the progress of a new run."""
        return cls(
            network=network,
            optimizer_state=eqx.filter_jit(optimizer.init)(network),  # pyright: ignore[reportArgumentType]
            best=network,
            best_error=WORST_ERROR,
            chunk=0,
            stale=0,
        )

    def judged(self, error: float) -> TrainingState:
        """Return the progress after a validation with this `error`."""
        if error < self.best_error:
            return self._replace(best=self.network, best_error=error, stale=0)
        return self._replace(stale=self.stale + 1)


def write_checkpoint(folder: Place, identity: str, progress: TrainingState) -> None:
    """Replace the checkpoint in `folder` as a whole."""
    numbers = {"best_error": progress.best_error, "chunk": progress.chunk, "stale": progress.stale}
    write_tree(folder, identity, _arrays(progress), numbers)


def read_checkpoint(folder: Place, identity: str, fresh: TrainingState) -> TrainingState:
    """Return the progress stored in `folder`, or `fresh` if there is none; see `read_tree`."""
    found = read_tree(folder, identity, _arrays(fresh), _numbers)
    if found is None:
        return fresh
    (network, optimizer_state, best), (best_error, chunk, stale) = found
    return TrainingState(network, optimizer_state, best, best_error, chunk, stale)


def _arrays(progress: TrainingState) -> Any:
    return progress.network, progress.optimizer_state, progress.best


def write_tree(folder: Place, identity: str, tree: Any, numbers: dict[str, Any]) -> None:
    """Replace the checkpoint in `folder` by the arrays of `tree` and by `numbers`, as a whole."""
    header = {"kind": "checkpoint", "identity": identity, **numbers}
    write_tensors(folder / NAME, to_numpy(_leaves_by_path(tree)), header)


def read_tree(
    folder: Place,
    identity: str,
    fresh: Any,
    numbers_of: Callable[[dict[str, Any]], Numbers],
    largest: int = SIZE_LIMIT,
) -> tuple[Any, Numbers] | None:
    """Return (a tree like `fresh`, the numbers) of the checkpoint in `folder`; None if there is none.

    `numbers_of` reads the numbers, and raises ValueError for wrong ones. BadFileError if the checkpoint is damaged, has more than
    `largest` bytes, or belongs to other data or another configuration.
    """
    path = folder / NAME
    if not path.exists():
        return None
    tensors, metadata = read_tensors(path, "checkpoint", largest=largest)
    if metadata.get("identity") != identity:
        raise BadFileError(
            f"{folder} holds a run with other data or settings, or of another version. Choose another --out, or "
            "remove that folder."
        )
    try:
        arrays = checked_arrays(_leaves_by_path(fresh), tensors)
        numbers = numbers_of(metadata)
    except ValueError as error:
        raise BadFileError(
            f"{path} is damaged: {error}. Remove {folder} to train from the start."
        ) from error
    return jax.tree.unflatten(jax.tree.structure(fresh), arrays), numbers


def _leaves_by_path(tree: Any) -> dict[str, Any]:
    """Return every array of `tree` by its path. Checkpoints are read by the program that wrote them."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path): leaf for path, leaf in leaves}


def _numbers(metadata: dict[str, Any]) -> tuple[float, int, int]:
    """Return (best error, chunks done, reports since the best one); ValueError names the one at fault."""
    best_error = number(metadata.get("best_error"), "best_error", least=0)
    chunk = whole(metadata.get("chunk"), "chunk", 0, MAX_CHUNKS)
    return best_error, chunk, whole(metadata.get("stale"), "stale", 0, MAX_CHUNKS)
