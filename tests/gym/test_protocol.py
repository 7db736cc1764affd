"""Gymnasium's protocol whole: its own vector environments of our single ones are the oracle of ours."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from waiting import PATIENCE

import neuroanimator.gym
from neuroanimator import Emulator, NeuroAnimatorError
from neuroanimator.gym import EmulatorEnv, EmulatorVectorEnv, PhysicsVectorEnv
from neuroanimator.gym.single_env import SingleEnv
from neuroanimator.gym.task_envs import TaskEnv, TaskVectorEnv
from neuroanimator.gym.vector_env import RowsVectorEnv

ROWS = 3
MODES = list(AutoresetMode)

Pair = tuple[Callable[[], gymnasium.Env], Callable[[AutoresetMode], RowsVectorEnv]]
"""(makes a single environment, makes the vector environment of `ROWS` in an autoreset mode)."""

PROGRAM = """
import sys
import gymnasium
import neuroanimator.gym

if __name__ == "__main__":
    context = sys.argv[1]
    envs = gymnasium.make_vec(
        "neuroanimator/pendulum-v0",
        num_envs=1,
        vectorization_mode="async",
        vector_kwargs={"context": context},
    )
    print(envs.reset(seed=0)[0].shape)
    envs.close()
"""


@pytest.fixture(params=["emulator", "physics", "task"])
def pair(request: pytest.FixtureRequest, shipped: Emulator) -> Pair:
    """Each kind of environment, with episodes that end soon and apart."""
    if request.param == "task":
        return _short_task, _short_tasks
    soon = 4 * shipped.dt
    if request.param == "physics":
        return (
            lambda: SingleEnv(PhysicsVectorEnv(shipped, 1, seconds=soon)),
            lambda mode: PhysicsVectorEnv(shipped, ROWS, seconds=soon, autoreset_mode=mode),
        )
    return (
        lambda: EmulatorEnv(shipped, seconds=soon),
        lambda mode: EmulatorVectorEnv(shipped, ROWS, seconds=soon, autoreset_mode=mode),
    )


def _short_task() -> TaskEnv:
    env = TaskEnv("pendulum-swing-up")
    env.vector_env.rows.steps = 4
    return env


def _short_tasks(mode: AutoresetMode) -> TaskVectorEnv:
    env = TaskVectorEnv("pendulum-swing-up", ROWS, autoreset_mode=mode)
    env.rows.steps = 4
    return env


def assert_same(one: Any, other: Any) -> None:
    """Assert that results of `reset` or `step` are alike, `info` with its masks included."""
    if isinstance(one, dict):
        assert set(one) == set(other)
        for name, part in one.items():
            assert_same(part, other[name])
    elif isinstance(one, tuple):
        for mine, theirs in zip(one, other, strict=True):
            assert_same(mine, theirs)
    elif one.dtype == object:
        for mine, theirs in zip(one, other, strict=True):
            assert (mine is None) == (theirs is None)
            if mine is not None:
                assert_same(mine, theirs)
    else:
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("mode", MODES)
def test_a_vector_environment_is_gymnasiums_own_of_single_ones(pair: Pair, mode: AutoresetMode):
    single, many = pair
    ours = many(mode)
    oracle = SyncVectorEnv([single] * ROWS, autoreset_mode=mode)
    space = ours.action_space
    space.seed(0)
    seeds: list[int | None] = [5, 3, 9]
    assert_same(ours.reset(seed=seeds), oracle.reset(seed=seeds))
    # Rows end apart from here on.
    ours.step(space.sample() * 0)
    oracle.step(space.sample() * 0)
    mask = np.array([False, True, False])
    assert_same(
        ours.reset(seed=1, options={"reset_mask": mask}),
        oracle.reset(seed=1, options={"reset_mask": mask}),
    )
    ends = 0
    for _ in range(12):
        actions = space.sample()
        made = ours.step(actions)
        assert_same(made, oracle.step(actions))
        over = made[2] | made[3]
        ends += over.sum()
        if mode is AutoresetMode.DISABLED and over.any():
            with pytest.raises(NeuroAnimatorError, match="Reset them before the next step"):
                ours.step(actions)
            assert_same(
                ours.reset(options={"reset_mask": over}), oracle.reset(options={"reset_mask": over})
            )
    assert ends > ROWS
    ours.close()
    ours.close()


def test_statistics_of_episodes_count_each_step_once(shipped: Emulator):
    for mode in MODES:
        plain = EmulatorVectorEnv(shipped, 2, seconds=4 * shipped.dt, autoreset_mode=mode)
        env = RecordEpisodeStatistics(plain)
        env.reset(seed=0)
        for _ in range(2):
            env.step(env.action_space.sample())
        env.reset(options={"reset_mask": np.array([True, False])})
        env.step(env.action_space.sample())
        *_, info = env.step(env.action_space.sample())
        assert info["episode"]["l"].tolist() == [0, 4]
        assert info["_episode"].tolist() == [False, True]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": [1]}, "seed: wanted a number, or one for each of 2 rows, got 1"),
        ({"options": {"reset_mask": [True]}}, "reset_mask: wanted 2 of True and False"),
        ({"options": {"reset_mask": [0, 1]}}, "reset_mask: wanted 2 of True and False"),
        ({"options": {"reset_mask": [False] * 2}}, "one of them True"),
    ],
)
def test_a_wrong_reset_is_refused(shipped: Emulator, arguments: dict[str, Any], message: str):
    with pytest.raises(NeuroAnimatorError, match=message):
        EmulatorVectorEnv(shipped, 2).reset(**arguments)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_alike_and_apart(pair: Pair, copied: Callable[[RowsVectorEnv], RowsVectorEnv]):
    _, many = pair
    env = many(AutoresetMode.NEXT_STEP)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(8)]
    env.step(actions[0])
    other = copied(env)
    ours = [env.step(action) for action in actions]
    theirs = [other.step(action) for action in actions]
    assert_same(tuple(ours), tuple(theirs))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_process_forked_after_jax_is_refused_at_once(shipped: Emulator):
    env = EmulatorEnv(shipped)
    env.reset(seed=0)
    uses = [
        lambda: EmulatorEnv(shipped),
        lambda: gymnasium.make("neuroanimator/pendulum-swing-up-v0"),
        lambda: env.reset(),
        lambda: env.step(env.action_space.sample()),
        lambda: pickle.loads(pickled),
    ]
    pickled = pickle.dumps(env)
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_tell_refusals, args=(uses, sender))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # JAX's own, and Python's
        process.start()
    try:
        assert receiver.poll(60)
        told = receiver.recv()
    finally:
        process.kill()
        process.join()
    assert len(told) == len(uses)
    for line in told:
        assert "forked from one in which JAX runs" in line
        assert "vector_kwargs={'context': 'spawn'}" in line
        assert "\n" not in line


def _tell_refusals(uses: list[Callable[[], Any]], sender: Any) -> None:
    told = []
    for use in uses:
        try:
            use()
        except neuroanimator.errors.ResourceError as error:
            told.append(str(error))
    sender.send(told)


@pytest.mark.parametrize(
    ("context", "said"),
    [
        ("fork", "in which JAX runs"),
        pytest.param("spawn", "(1, ", marks=pytest.mark.endurance),  # as any new process
    ],
)
def test_forked_workers_are_refused_and_spawned_ones_work(context: str, said: str, tmp_path: Path):
    """They hung for ever: JAX's threads are not there after a fork."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    run = subprocess.run(
        [sys.executable, program, context],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert said in run.stdout + run.stderr
    assert (run.returncode == 0) == (context == "spawn")
