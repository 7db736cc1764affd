"""Train the emulator on what happened in an environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.store import Transitions, windows_of
from neuroanimator.learn.finetune import REFINING_UPDATES, train_on
from neuroanimator.learn.planning.environments import Episode

SEEN_SHARE = 0.3
"""Share of all windows that come from episodes: enough to matter, while the rest keeps other knowledge."""


def learn_from(
    emulator: Emulator,
    episodes: Sequence[Episode],
    data: Transitions,
    *,
    updates: int = REFINING_UPDATES,
) -> Emulator:
    """Return a copy of the emulator trained further, for some seconds, on `episodes` mixed with the `data` it was made from."""
    return train_on(emulator, with_episodes(data, episodes), updates)


def with_episodes(data: Transitions, episodes: Sequence[Episode]) -> Transitions:
    """Return `data` and the windows of `episodes`, repeated until they are `SEEN_SHARE` of all.

    A super step that the environment ended early is left out. Raises ArgumentError if no episode is as long as a window.
    """
    length = data.system.window_steps
    if all(episode.whole_steps < length for episode in episodes):
        raise ArgumentError(f"episodes: wanted one of at least {length} super steps.")
    windows = []
    for number, episode in enumerate(episodes):
        tensors = {
            "states": episode.states[None],
            "controls": episode.controls[None],
            "samples": np.arange(episode.whole_steps - length + 1)[None],
            "segments": np.array([number]),
        }
        windows.append(windows_of(tensors, length))
    states, controls, runs = (np.concatenate(parts) for parts in zip(*windows, strict=True))
    wanted = SEEN_SHARE / (1 - SEEN_SHARE) * len(data.states)
    times = max(1, round(wanted / len(runs)))
    return replace(
        data,
        states=np.concatenate([data.states, *[states.astype(np.float32)] * times]),
        controls=np.concatenate([data.controls, *[controls.astype(np.float32)] * times]),
        run=np.concatenate([data.run, *[runs + data.run.max() + 1] * times]),
    )
