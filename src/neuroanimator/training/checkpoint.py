"""Checkpoints of a training run, on disk or in an object store."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import optax

from neuroanimator.emulator.networks.network import Network
from neuroanimator.emulator.tensors import checked_arrays, to_numpy
from neuroanimator.errors import BadFileError
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.files.places import Place

NAME = "checkpoint.safetensors"

MAX_CHUNKS = 2**31
"""JAX counts them in 32 bits."""


WORST_ERROR = 1e30
"""Validation error before the first validation; any real one is lower, and JSON has no infinity."""


class Progress(NamedTuple):
    """Everything the rest of a run depends on."""

    network: Network
    optimizer_state: Any
    best: Network
    """The network with the lowest validation error so far."""
    best_error: float
    chunk: int
    """Chunks done."""
    stale: int
    """Reports since the best one."""

    @classmethod
    def fresh(cls, network: Network, optimizer: optax.GradientTransformation) -> Progress:
        """Return the progress of a run that has not begun."""
        return cls(
            network=network,
            optimizer_state=eqx.filter_jit(optimizer.init)(network),  # pyright: ignore[reportArgumentType]
            best=network,
            best_error=WORST_ERROR,
            chunk=0,
            stale=0,
        )

    def judged(self, error: float) -> Progress:
        """Return the progress after a validation that found `error`."""
        if error < self.best_error:
            return self._replace(best=self.network, best_error=error, stale=0)
        return self._replace(stale=self.stale + 1)


def write_checkpoint(folder: Place, identity: str, progress: Progress) -> None:
    """Replace the checkpoint in `folder` as a whole."""
    tree = (progress.network, progress.optimizer_state, progress.best)
    tensors = to_numpy(_leaves_by_path(tree))
    numbers = {"best_error": progress.best_error, "chunk": progress.chunk, "stale": progress.stale}
    write_tensors(folder / NAME, tensors, {"kind": "checkpoint", "identity": identity, **numbers})


def read_checkpoint(folder: Place, identity: str, fresh: Progress) -> Progress:
    """Return the progress stored in `folder`, or `fresh` if there is none.

    BadFileError if it belongs to other data or another configuration.
    """
    path = folder / NAME
    if not path.exists():
        return fresh
    tensors, metadata = read_tensors(path, "checkpoint")
    if metadata.get("identity") != identity:
        raise BadFileError(
            f"{folder} holds a run with other data or settings. Choose another --out, or remove that folder."
        )
    tree = (fresh.network, fresh.optimizer_state, fresh.best)
    try:
        arrays = checked_arrays(_leaves_by_path(tree), tensors)
        best_error, chunk, stale = _numbers(metadata)
    except ValueError as error:
        raise BadFileError(f"{path} is damaged: {error}. Remove {folder} to train anew.") from error
    network, optimizer_state, best = jax.tree.unflatten(jax.tree.structure(tree), arrays)
    return Progress(network, optimizer_state, best, best_error, chunk, stale)


def _leaves_by_path(tree: Any) -> dict[str, Any]:
    """Return every array of `tree` by its path. Checkpoints are read by the program that wrote them."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
    return {jax.tree_util.keystr(path): leaf for path, leaf in leaves}


def _numbers(metadata: dict[str, Any]) -> tuple[float, int, int]:
    """Return (best error, chunks done, reports since the best one); ValueError names what is no such number."""
    best_error = metadata.get("best_error")
    if not isinstance(best_error, int | float) or best_error < 0:
        raise ValueError(f"best_error is {str(best_error)[:40]!r}")
    for key in ("chunk", "stale"):
        if type(metadata.get(key)) is not int or not 0 <= metadata[key] < MAX_CHUNKS:
            raise ValueError(f"{key} is {str(metadata.get(key))[:40]!r}")
    return best_error, metadata["chunk"], metadata["stale"]
