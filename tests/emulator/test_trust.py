"""The score of trust: 1 is the edge of training, whatever the mirror, the file or the program; and above it errors grow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from neuroanimator import DatasetConfig, Emulator, NeuroAnimatorError, load_emulator
from neuroanimator.emulator.networks.network import Units
from neuroanimator.emulator.super_step import trust
from neuroanimator.emulator.trust import EDGE, TrustMeter
from neuroanimator.emulator.trust_summary import summary_of
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training.trust_fitting import Inputs, fit_meter, fit_trust
from neuroanimator.state.body_frame import Frame

JUMP = 2.0
"""States that are shifted go so many times as fast."""


@pytest.fixture(scope="module")
def unseen() -> Transitions:
    """Super steps of pendulums that `pendulum-50` never saw."""
    return simulate_transitions(DatasetConfig(system="pendulum", count=6_000, seed=77))


def scores_of(emulator: Emulator, states: np.ndarray, controls: np.ndarray) -> np.ndarray:
    return emulator.trust(states.astype(float), controls.astype(float))


def errors_of(
    emulator: Emulator, states: np.ndarray, controls: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """Return rms errors of super steps, in units of the usual change."""
    emulated = emulator.rollout(states, controls[:, None])[:, 1]
    difference = Frame.of(emulator.state_structure, emulator.dt).difference(ends, emulated)
    return np.sqrt(np.mean((difference / np.asarray(emulator.normaliser.unit)) ** 2, axis=1))


def area_under_curve(scores: np.ndarray, is_large: np.ndarray) -> float:
    """Return how often a large error has a higher score than another (Mann and Whitney, 1947)."""
    ranks = np.argsort(np.argsort(scores)) + 1
    large = is_large.sum()
    return float(
        (ranks[is_large].sum() - large * (large + 1) / 2) / (large * (len(scores) - large))
    )


def test_ninety_nine_of_a_hundred_unseen_super_steps_lie_within_the_edge(
    shipped: Emulator, unseen: Transitions
):
    scores = scores_of(shipped, unseen.states[:, 0], unseen.controls[:, 0])
    assert 0.97 < np.mean(scores <= EDGE) < 0.999


def test_scores_tell_where_errors_are_large(shipped: Emulator, unseen: Transitions):
    starts = unseen.states[:2000, 0].astype(float)
    starts[1000:, 3:] *= JUMP
    controls = unseen.controls[:2000, :1].astype(float)
    ends = unseen.system.simulate(starts, controls, shipped.dt).states[:, 1]
    errors = errors_of(shipped, starts, controls[:, 0], ends)
    large = errors > np.quantile(errors[:1000], 0.95)
    assert area_under_curve(scores_of(shipped, starts, controls[:, 0]), large) > 0.9


@pytest.mark.parametrize("name", ["pendulum-50", "dolphin-50"])
def test_a_mirrored_input_is_trusted_as_much(name: str):
    emulator = load_emulator(name)
    assert emulator.meter is not None
    rng = np.random.default_rng(0)
    odd, even = (jax.numpy.array(rng.normal(size=count)) for count in emulator.network.unit_counts)
    score = emulator.meter.squared(Units(odd, even))
    assert score > 0
    assert emulator.meter.squared(Units(-odd, even)) == score


def test_what_is_no_number_or_far_out_is_never_trusted(shipped: Emulator):
    rest, still = shipped.rest, np.zeros(3)
    assert shipped.trust(rest, still) <= EDGE
    for entry in range(len(rest)):
        for wrong in (np.nan, np.inf, -np.inf, 1e30):
            state = rest.copy()
            state[entry] = wrong
            assert shipped.trust(state, still) == np.inf
            assert not shipped.covers(state, still)
    assert shipped.trust(rest, np.array([0, np.nan, 0])) == np.inf
    assert shipped.trust(rest + 1000 * (np.arange(6) > 2), still) > 10


def test_a_batch_is_scored_row_by_row_and_as_in_jax(shipped: Emulator, unseen: Transitions):
    states = unseen.states[:40, 0].astype(float)
    controls = unseen.controls[:40, 0].astype(float)
    scores = shipped.trust(states, controls)
    assert scores.shape == (40,)
    held = np.broadcast_to(controls[0], controls.shape)
    np.testing.assert_array_equal(shipped.trust(states, held), shipped.trust(states, held.copy()))
    rows = [shipped.trust(*row) for row in zip(states, controls, strict=True)]
    np.testing.assert_allclose(scores, rows, rtol=1e-4)
    in_jax = jax.vmap(trust, (None, 0, 0))(shipped, np.float32(states), np.float32(controls))
    np.testing.assert_allclose(scores, in_jax, rtol=1e-3, atol=1e-5)
    with pytest.raises(NeuroAnimatorError, match="as many of one as of the other"):
        shipped.trust(states, controls[:7])


def test_a_file_without_a_meter_knows_its_ranges_and_can_be_given_one(
    shipped: Emulator, unseen: Transitions, tmp_path: Path
):
    replace(shipped, meter=None).save(tmp_path / "old.safetensors")
    old = Emulator.load(tmp_path / "old.safetensors")
    assert old.meter is None
    assert old.trust(old.rest, np.zeros(3)) == 0
    assert old.trust(old.rest + 100, np.zeros(3)) > EDGE
    fitted = fit_trust(old, unseen)
    fitted.save(tmp_path / "new.safetensors")
    again = Emulator.load(tmp_path / "new.safetensors")
    states, controls = unseen.states[:100, 0], unseen.controls[:100, 0]
    np.testing.assert_array_equal(
        scores_of(again, states, controls), scores_of(fitted, states, controls)
    )
    assert 0.9 < np.mean(scores_of(again, states, controls) <= EDGE) <= 1


@pytest.mark.parametrize("counts", [[0, 0], [-1, 3], [3], [1e9, 0], "16", [16, 5], None])
def test_a_meter_that_does_not_fit_is_refused(shipped: Emulator, tmp_path: Path, counts: object):
    path = tmp_path / "forged.safetensors"
    shipped.save(path)
    tensors, metadata = read_tensors(path, "emulator")
    metadata.pop("sha256", None)
    write_tensors(path, tensors, {**metadata, "trust": counts})
    with pytest.raises(NeuroAnimatorError, match="not a usable emulator"):
        Emulator.load(path)


def test_scores_do_not_depend_on_what_units_are_measured_in():
    rng = np.random.default_rng(3)
    odd, even = rng.normal(size=(2000, 6)), rng.normal(size=(2000, 5)) + 2
    errors = np.abs(odd[:, 0]) + 0.1 * np.abs(even[:, 1] - 2)
    meter = fit_meter(Inputs(odd, even, errors))
    turn = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    turned = fit_meter(Inputs(3 * odd @ turn, 3 * even, errors))

    def scores(meter: TrustMeter, odd: np.ndarray, even: np.ndarray) -> np.ndarray:
        away = (odd @ meter.odd) ** 2
        return np.sqrt(away.sum(1) + (((even - meter.even_mean) @ meter.even) ** 2).sum(1))

    np.testing.assert_allclose(
        scores(meter, odd, even), scores(turned, 3 * odd @ turn, 3 * even), rtol=1e-3
    )
    assert np.mean(scores(meter, odd, even) <= EDGE) == pytest.approx(0.99, abs=0.002)


def test_scores_have_gradients_everywhere_that_are_those_of_finite_differences(shipped: Emulator):
    def score(emulator: Emulator, state: jax.Array) -> jax.Array:
        return trust(emulator, state, jax.numpy.zeros(3))

    state = jax.numpy.asarray(shipped.rest + 0.3, np.float32)
    slope = np.asarray(jax.grad(score, argnums=1)(shipped, state))
    for entry in range(6):
        step = np.zeros(6, np.float32)
        step[entry] = 1e-2
        rise = score(shipped, state + step) - score(shipped, state - step)
        assert rise / 2e-2 == pytest.approx(slope[entry], rel=0.03, abs=0.01)
    inside = replace(shipped, meter=None)  # by ranges alone the score is 0 there
    assert float(score(inside, state)) == 0
    np.testing.assert_array_equal(jax.grad(score, argnums=1)(inside, state), 0)


def test_a_motion_is_summed_up_in_a_line(shipped: Emulator):
    scores = np.array([0.2, 0.4, 2.5, 0.1])
    told = str(summary_of(shipped, scores))
    share, _, judged = told.partition("; ")
    assert share == "75% of it within training, highest score 2.50 at 0.10 s (edge 1)"
    assert judged == f"there the emulator is {shipped.verdict}"
    assert "all of it within training" in str(summary_of(shipped, scores[:2]))
    old = replace(shipped, meter=None)
    assert "75% of it within the ranges of training (the file is too old to have" in str(
        summary_of(old, scores)
    )
