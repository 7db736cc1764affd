"""Emulator and physics in turns: each does to the last bit what it does alone, from the state the other left."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli

from neuroanimator import (
    Emulator,
    NeuroAnimatorError,
    hybrid_rollout,
    load_emulator,
    load_system,
)
from neuroanimator.animation.motion import default_drive
from neuroanimator.emulator.trust import EDGE
from neuroanimator.emulator.trust_summary import summary_of
from neuroanimator.learn.evaluation.held_out import held_out_runs
from neuroanimator.learn.evaluation.hybrid_shares import THRESHOLDS, hybrid_gain, hybrid_shares
from neuroanimator.physics.hybrid import PHYSICS_STEPS, HybridMotion

STEPS = 32
SYSTEM = load_system("pendulum")
START = np.array([0.4, -1.0, 0.7, 3.0, -6.0, 4.0])
"""Fast enough that the emulator is trusted at some times and not at others."""


@pytest.fixture(scope="module")
def controls() -> np.ndarray:
    return SYSTEM.bounds.middle + np.random.default_rng(4).uniform(-1, 1, (STEPS, 3)) * (
        SYSTEM.bounds.half
    )


@pytest.fixture(scope="module")
def motion(shipped: Emulator, controls: np.ndarray) -> HybridMotion:
    """A motion with several hand-overs."""
    return hybrid_rollout(shipped, SYSTEM, START, controls, threshold=EDGE)


def stretches(is_physics: np.ndarray) -> list[slice]:
    """Return where one of the two goes on without the other."""
    ends = np.flatnonzero(np.diff(is_physics.astype(int))) + 1
    marks = [0, *ends, len(is_physics)]
    return [slice(*pair) for pair in pairwise(marks)]


def by_physics(shipped: Emulator, start: np.ndarray, controls: np.ndarray) -> np.ndarray:
    return SYSTEM.simulate_fastest(start[None], controls[None], shipped.dt).states[0]


def test_with_a_threshold_of_0_it_is_the_physics_to_the_bit(
    shipped: Emulator, controls: np.ndarray
):
    motion = hybrid_rollout(shipped, SYSTEM, START, controls, threshold=0)
    np.testing.assert_array_equal(motion.states, by_physics(shipped, START, controls))
    assert motion.physics_share == 1
    scores = shipped.trust(motion.states[:-1], controls)
    np.testing.assert_allclose(motion.scores, scores, rtol=1e-5)


def test_with_an_infinite_threshold_it_is_the_emulator_to_the_bit(
    shipped: Emulator, controls: np.ndarray
):
    motion = hybrid_rollout(shipped, SYSTEM, START, controls, threshold=np.inf)
    states, scores = shipped.rollout_trusted(START, controls)
    np.testing.assert_array_equal(motion.states[1:], states[1:])
    np.testing.assert_array_equal(motion.scores, scores)
    assert motion.physics_share == 0


def test_each_goes_on_from_the_very_state_the_other_left(
    shipped: Emulator, controls: np.ndarray, motion: HybridMotion
):
    assert 0 < motion.physics_share < 1
    assert len(stretches(motion.is_physics)) > 2
    for part in stretches(motion.is_physics):
        start = motion.states[part.start]
        expected = shipped.rollout(start, controls[part])
        if motion.is_physics[part.start]:
            expected = by_physics(shipped, start, controls[part])
        np.testing.assert_allclose(
            motion.states[part.start + 1 : part.stop + 1], expected[1:], rtol=1e-4, atol=1e-4
        )


def test_the_physics_makes_what_is_not_trusted_and_stays_a_while(motion: HybridMotion):
    assert (motion.scores[~motion.is_physics] < EDGE).all()
    for part in stretches(motion.is_physics):
        if motion.is_physics[part.start]:
            assert motion.scores[part.start] >= EDGE
            assert part.stop - part.start >= PHYSICS_STEPS or part.stop == STEPS
            assert (motion.scores[part.start + PHYSICS_STEPS : part.stop] >= EDGE).all()


def test_the_lower_the_threshold_the_more_is_physics_and_the_less_goes_astray(
    shipped: Emulator, controls: np.ndarray
):
    truth = by_physics(shipped, START, controls)
    shares = []
    errors = []
    for threshold in (0.2, 0.6, np.inf):
        motion = hybrid_rollout(shipped, SYSTEM, START, controls, threshold=threshold)
        shares.append(motion.physics_share)
        errors.append(np.abs(motion.states - truth).max())
    assert shares == sorted(shares, reverse=True)
    assert errors[0] < errors[-1]


def test_a_motion_of_no_super_steps_is_its_start(shipped: Emulator):
    motion = hybrid_rollout(shipped, SYSTEM, START, np.zeros((0, 3)))
    np.testing.assert_array_equal(motion.states, START[None])
    assert motion.physics_share == 0


@pytest.mark.parametrize("threshold", [-0.1, np.nan])
def test_a_threshold_that_is_no_score_is_refused(shipped: Emulator, threshold: float):
    with pytest.raises(NeuroAnimatorError, match="threshold: wanted a score"):
        hybrid_rollout(shipped, SYSTEM, START, np.zeros((2, 3)), threshold=threshold)


def test_another_system_no_time_and_batches_are_refused(shipped: Emulator):
    for system, steps, state in (
        (load_system("lander"), 3, START),
        (SYSTEM, 0, START),
        (SYSTEM, 3, START[None]),
        (SYSTEM, 3, START * np.nan),
    ):
        with pytest.raises(NeuroAnimatorError):
            hybrid_rollout(shipped, system, state, np.zeros((2, 3)), physics_steps=steps)


def test_a_rollout_with_scores_is_the_rollout_and_its_scores(
    shipped: Emulator, controls: np.ndarray
):
    states, scores = shipped.rollout_trusted(START, controls)
    np.testing.assert_allclose(states, shipped.rollout(START, controls), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(scores, shipped.trust(states[:-1], controls), rtol=1e-4)
    batch, of_batch = shipped.rollout_trusted(np.stack([START] * 2), np.stack([controls] * 2))
    np.testing.assert_allclose(batch, np.stack([states] * 2), rtol=1e-4, atol=1e-4)
    assert of_batch.shape == (2, STEPS)


def test_a_made_motion_has_one_score_whoever_asks(cli: Cli, tmp_path: Path):
    dolphin = load_emulator("dolphin-50")
    drive = default_drive(dolphin)  # it leaps, far beyond training
    states, scores = drive.trusted_motion(dolphin)
    made, of_rollout = dolphin.rollout_trusted(drive.start, drive.controls)
    np.testing.assert_array_equal(states, made)
    np.testing.assert_array_equal(scores, of_rollout)

    out = tmp_path / "swim.csv"
    told = cli("animate", "dolphin", "--out", out)
    printed = re.sub(r"\s+", " ", told.stdout)
    assert f"trust {summary_of(dolphin, scores)}" in printed, told.stdout + told.stderr

    # At the highest score the physics takes over in that super step and in none before.
    highest = int(np.argmax(scores))
    assert highest > 0
    physics = load_system("dolphin")
    start, held = drive.start, drive.controls[: highest + 1]
    motion = hybrid_rollout(dolphin, physics, start, held, threshold=float(scores[highest]))
    np.testing.assert_array_equal(motion.scores, scores[: highest + 1])
    assert motion.is_physics.tolist() == [False] * highest + [True]


def test_what_turns_are_worth_is_nothing_without_them_and_all_with_nothing_else(
    shipped: Emulator, controls: np.ndarray
):
    physics = hybrid_rollout(shipped, SYSTEM, START, controls, threshold=0)
    gain = hybrid_gain(shipped, SYSTEM, physics, controls)
    assert gain.error == 0 < gain.emulator_error
    emulator = hybrid_rollout(shipped, SYSTEM, START, controls, threshold=np.inf)
    gain = hybrid_gain(shipped, SYSTEM, emulator, controls)
    assert gain.error == pytest.approx(gain.emulator_error, rel=1e-2)
    assert str(gain).startswith("0% of the time by physics")


def test_a_report_has_shares_and_errors_by_threshold(shipped: Emulator):
    test = held_out_runs(shipped, count=3, seconds=1.0)
    shares = hybrid_shares(shipped, test, 3)
    assert tuple(shares) == THRESHOLDS
    first, *_, last = shares.values()
    assert first.physics_share <= last.physics_share
    assert last.error < last.emulator_error
