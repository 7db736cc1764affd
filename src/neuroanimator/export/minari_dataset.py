"""Motions as a dataset of Minari, the format in which offline reinforcement learning exchanges episodes.

Minari's own library (the extra `[minari]`) writes it, into a folder that stands for its store of datasets.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from neuroanimator.animation.motion import random_drive
from neuroanimator.emulator.emulator import Emulator, as_emulator
from neuroanimator.errors import ArgumentError, ResourceError
from neuroanimator.evaluation.held_out import system_of

FORMAT = "minari"
"""What `--format` says."""

USUAL_EPISODES = 20
"""Episodes if nothing else is said."""

MAX_EPISODES = 100_000
"""The most episodes of one dataset."""

FOLDER_VARIABLE = "MINARI_DATASETS_PATH"
"""Where Minari looks for its folder of datasets."""

HOW_TO_GET_IT = (
    "A Minari dataset is written by the package minari. Install it with: "
    "pip install 'neuroanimator[minari]'"
)


class MinariDataset(NamedTuple):
    """What was written."""

    folder: Path
    """Minari's folder of datasets, new."""
    id: str
    """The dataset's name in it, for `minari.load_dataset`."""
    episodes: int
    steps: int
    """Super steps of all episodes together."""


def write_minari(
    reference: str | Emulator,
    folder: str | Path,
    *,
    episodes: int = USUAL_EPISODES,
    seconds: float | None = None,
    seed: int = 0,
    on_physics: bool = False,
) -> MinariDataset:
    """Write `episodes` of random, never idle controls as a Minari dataset into the new `folder`.

    Each is `seconds` long and is what the emulator makes of its controls, or what the true physics does if
    `on_physics`. Observations are states, actions are controls, one a super step; rewards are 0, since a motion alone
    has no aim, and every episode ends by truncation. One that comes to no finite numbers is left out.

    Raises ArgumentError for a folder that has something in it, and for numbers out of range; ResourceError without
    the extra `[minari]`.
    """
    folder = Path(folder)
    emulator = as_emulator(reference)
    if not 1 <= episodes <= MAX_EPISODES:
        raise ArgumentError(f"episodes: wanted 1 to {MAX_EPISODES:,}, came {episodes}.")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ArgumentError(f"out: '{folder}' has something in it. Name a new folder.")
    minari = _library()
    starts, controls = _drives(emulator, episodes, seconds, seed)
    states = _trajectories(emulator, starts, controls, on_physics)
    bounds = emulator.bounds
    low = np.array(bounds.low, np.float32)
    high = np.array(bounds.high, np.float32)
    buffers = []
    for number, (path, held) in enumerate(zip(states, controls, strict=True)):
        if np.isfinite(path).all():
            actions = np.clip(held.astype(np.float32), low, high)
            buffers.append(_buffer(minari, len(buffers), seed + number, path, actions))
    if not buffers:
        raise ArgumentError(f"No episode of {emulator.system} came to finite numbers.")
    kind = "physics" if on_physics else "emulator"
    name = f"neuroanimator/{emulator.system}-{emulator.substeps}/{kind}-v0"
    with _new_folder(folder), warnings.catch_warnings():
        # It warns of an author, an environment and a link that such a dataset does not have.
        warnings.simplefilter("ignore", UserWarning)
        box = minari.Box
        dataset = minari.create_dataset_from_buffers(
            name,
            buffers,
            observation_space=box(-np.inf, np.inf, (emulator.state.size,), np.float32),
            action_space=box(low, high, dtype=np.float32),
            algorithm_name="random controls",
            description=_description(emulator, kind),
            requirements=[f"neuroanimator=={version('neuroanimator')}"],
        )
        dataset.storage.update_metadata(_facts(emulator, kind))
    return MinariDataset(folder, name, len(buffers), sum(len(one.rewards) for one in buffers))


class _Library(NamedTuple):
    """What is needed of Minari and Gymnasium."""

    create_dataset_from_buffers: Any
    EpisodeBuffer: Any
    Box: Any


def _library() -> _Library:
    try:
        import h5py  # noqa: F401  # pyright: ignore[reportMissingImports]
        from gymnasium.spaces import Box
        from minari import create_dataset_from_buffers  # pyright: ignore[reportMissingImports]
        from minari.data_collector import EpisodeBuffer  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ResourceError(HOW_TO_GET_IT) from None
    return _Library(create_dataset_from_buffers, EpisodeBuffer, Box)


def _drives(
    emulator: Emulator, episodes: int, seconds: float | None, seed: int
) -> tuple[Float[np.ndarray, "B S"], Float[np.ndarray, "B T C"]]:
    """Return where the episodes begin and what drives them."""
    if seed < 0:
        raise ArgumentError(f"seed: wanted 0 or more, came {seed}.")
    # The seed 0 of a motion is one to look at, the same for all.
    drives = [random_drive(emulator, seconds, 1 + seed + number) for number in range(episodes)]
    starts = np.stack([drive.start for drive in drives])
    return starts, np.stack([np.asarray(drive.controls, float) for drive in drives])


def _trajectories(
    emulator: Emulator,
    starts: Float[np.ndarray, "B S"],
    controls: Float[np.ndarray, "B T C"],
    on_physics: bool,
) -> Float[np.ndarray, "B T+1 S"]:
    if on_physics:
        system = system_of(emulator)
        runs = system.simulate(starts, controls, emulator.dt, scheme=system.scheme)
        return np.asarray(runs.states)
    rollouts = [emulator.rollout(start, held) for start, held in zip(starts, controls, strict=True)]
    return np.asarray(rollouts, float)


def _buffer(
    minari: _Library,
    number: int,
    seed: int,
    states: Float[np.ndarray, "T1 S"],
    actions: Float[np.ndarray, "T C"],
) -> Any:
    """Return one episode, as Minari takes it."""
    steps = len(actions)
    is_last = np.arange(steps) == steps - 1
    return minari.EpisodeBuffer(
        id=number,
        seed=seed,
        observations=states.astype(np.float32),  # pyright: ignore[reportArgumentType]
        actions=actions,  # pyright: ignore[reportArgumentType]
        rewards=[0.0] * steps,
        terminations=[False] * steps,
        truncations=is_last.tolist(),
    )


def _description(emulator: Emulator, kind: str) -> str:
    """Return what the dataset says about itself."""
    made = "the true physics did" if kind == "physics" else "its emulator did"
    return (
        f"{emulator.system} under random controls: what {made}, a state every {emulator.dt:g} s. "
        f"Observations: {', '.join(emulator.state.names)}. Actions: {', '.join(emulator.control.names)}. "
        "Rewards are 0: compute your own from the observations."
    )


def _facts(emulator: Emulator, kind: str) -> dict[str, Any]:
    """Return what is added to Minari's own metadata."""
    return {
        "system": emulator.system,
        "source": kind,
        "dt": emulator.dt,
        "substeps": emulator.substeps,
        "observation_names": list(emulator.state.names),
        "action_names": list(emulator.control.names),
    }


@contextmanager
def _new_folder(folder: Path) -> Iterator[None]:
    """Let Minari write into a folder beside `folder`, which takes its place when all is written."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside = folder.parent.resolve()
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=beside))
    except OSError as error:
        raise ResourceError(f"Could not write {folder}: {error.strerror}.") from error
    before = os.environ.get(FOLDER_VARIABLE)
    os.environ[FOLDER_VARIABLE] = str(scratch)
    try:
        yield
        if folder.is_dir():
            folder.rmdir()
        scratch.chmod(0o755)
        scratch.rename(folder)
    except OSError as error:
        raise ResourceError(f"Could not write {folder}: {error.strerror or error}.") from error
    finally:
        if before is None:
            del os.environ[FOLDER_VARIABLE]
        else:
            os.environ[FOLDER_VARIABLE] = before
        shutil.rmtree(scratch, ignore_errors=True)
