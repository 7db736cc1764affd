"""Train the emulator on what happened in an environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.store import Transitions
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
    states = []
    controls = []
    runs = []
    for number, episode in enumerate(episodes):
        firsts = np.arange(episode.whole_steps - length + 1)
        states.append(episode.states[firsts[:, None] + np.arange(length + 1)])
        controls.append(episode.controls[firsts[:, None] + np.arange(length)])
        runs.append(np.full(len(firsts), number))
    count = sum(map(len, runs))
    if not count:
        raise ArgumentError(f"episodes: wanted one of at least {length} super steps.")
    wanted = SEEN_SHARE / (1 - SEEN_SHARE) * len(data.states)
    times = max(1, round(wanted / count))
    seen_states = np.concatenate(states).astype(np.float32)
    seen_controls = np.concatenate(controls).astype(np.float32)
    seen_runs = np.concatenate(runs) + data.run.max() + 1
    return replace(
        data,
        states=np.concatenate([data.states, *[seen_states] * times]),
        controls=np.concatenate([data.controls, *[seen_controls] * times]),
        run=np.concatenate([data.run, *[seen_runs] * times]),
    )
