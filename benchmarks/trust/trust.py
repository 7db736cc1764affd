"""How well scores detect large errors of an emulator, beside other scores, and their cost; trust.csv.

python -m benchmarks.trust.trust                 every emulator of 50 substeps that ships, some minutes on two cores
python -m benchmarks.trust.trust fish-50         some of them; writes no file
python -m benchmarks.trust.trust draws [NAME…]   its AUROC for six draws of super steps; trust_draws.csv, some minutes
python -m benchmarks.trust.trust bounds [NAME…]  coverage of error bounds; trust_bounds.csv, ten minutes
python -m benchmarks.trust.trust others          the same for other sizes and super steps; trust_others.csv, twenty minutes
python -m benchmarks.trust.trust hybrid [NAME…]  gain from physics a tenth of the time; trust_hybrid.csv, ten minutes

Super steps are of two kinds, half of each: as in training, and shifted: controls at their bounds that jump at every super
step, controls held at their bounds for twenty, and starts that move 1.2 to 2 times as fast. An error is large if it is above the
95th percentile of errors on the first kind. AUROC is the probability that a large error has the higher score: 0.5 is guessing.

The baselines are fitted to the same unseen super steps as the score, and judged on others:

ranges    distance of the farthest feature outside its range in training (formerly the basis of `covers`)
features  Mahalanobis distance of all features
units     Mahalanobis distance of all units of the last layer
heads     disagreement of eight last layers, each fitted to equally many super steps drawn with replacement
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks.harness import Rows, keep_rows, parser_of, show_rows
from benchmarks.trust import bounds, hybrid
from neuroanimator import Emulator, load_emulator
from neuroanimator.codegen.cores import core_count
from neuroanimator.emulator.arrays import as_jax
from neuroanimator.emulator.c_emulator import c_emulator
from neuroanimator.files.zoo import LARGE, SHIPPED, emulator_name
from neuroanimator.learn.data.sampling import sample_starts
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.learn.evaluation.weakness.sampling import rate_entries
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.random_controls import sample_control_runs
from neuroanimator.systems.system import System
from neuroanimator.terminal import progress_bar

TABLE = Path(__file__).with_name("trust.csv")

NAMES = ("pendulum-50", "pendulum-passive-50", "truck-50", "lander-50", "fish-50", "dolphin-50")

OTHERS = tuple(
    name
    for name in (
        *(emulator_name(*row) for row in SHIPPED),
        *(emulator_name(*row, "large") for row in LARGE),
    )
    if name not in NAMES
)
"""The other emulators that ship."""

RUNS = 400
"""Number of runs of each kind."""

STEPS = 8
"""Super steps of each."""

HELD = 20
"""Super steps for which a control at its bounds is held."""

FASTER = (1.2, 2.0)
"""Factors by which shifted starts move faster."""

HEADS = 8
RIDGE = 1e-3

TIMED = 400
"""Super steps a turn of the clock."""

TURNS = 60
"""Turns of each kind, one after the other in turn."""


FIRST_SEED = 1
"""The first of three seeds of the table."""

DRAWS = (2100, 2200, 2300, 2400, 2500, 2600)
"""First seeds of draws that nothing was chosen by."""


class SuperSteps(NamedTuple):
    """Super steps by the true physics."""

    states: np.ndarray
    controls: np.ndarray
    ends: np.ndarray

    @classmethod
    def of(cls, system: System, starts: np.ndarray, controls: np.ndarray, dt: float) -> SuperSteps:
        """Return the super steps of runs that did not diverge."""
        runs = system.simulate(starts, controls, dt, threads=core_count())
        whole = ~runs.has_diverged
        parts = (runs.states[whole, :-1], controls[whole], runs.states[whole, 1:])
        return cls(*(part.reshape(-1, part.shape[-1]) for part in parts))

    def joined(self, *others: SuperSteps) -> SuperSteps:
        """Return all of them."""
        return SuperSteps(*(np.concatenate(parts) for parts in zip(self, *others, strict=True)))


def as_in_training(system: System, dt: float, seed: int) -> SuperSteps:
    """Return super steps as training has them, of another seed."""
    rng = np.random.default_rng([seed, 0])
    starts = sample_starts(system, rng, RUNS, core_count())
    controls = sample_control_runs(rng, RUNS, STEPS, dt, system)
    return SuperSteps.of(system, starts, controls, dt)


def shifted(system: System, dt: float, seed: int) -> SuperSteps:
    """Return super steps under controls and from starts that training did not have."""
    rng = np.random.default_rng([seed, 1])
    bounds = system.bounds
    count = RUNS // 3
    size = len(bounds.half)
    starts = [sample_starts(system, rng, count, core_count()) for _ in range(3)]
    jumping = bounds.middle + rng.choice([-1, 1], (count, STEPS, size)) * bounds.half
    signs = np.repeat(rng.choice([-1, 1], (count, 1, size)), HELD, axis=1)
    held = SuperSteps.of(system, starts[1], bounds.middle + signs * bounds.half, dt)
    rows = rng.permutation(len(held.states))[: count * STEPS]
    fast = starts[2]
    rates = rate_entries(system)
    fast[:, rates] *= rng.uniform(*FASTER, (count, 1))
    usual = sample_control_runs(rng, count, STEPS, dt, system)
    return SuperSteps.of(system, starts[0], jumping, dt).joined(
        SuperSteps(*(part[rows] for part in held)), SuperSteps.of(system, fast, usual, dt)
    )


def errors_of(emulator: Emulator, steps: SuperSteps, unit: np.ndarray) -> np.ndarray:
    """Return the rms error of each super step, in standard deviations of the usual change."""
    emulated = emulator.rollout(steps.states, steps.controls[:, None], may_diverge=True)[:, 1]
    frame = Frame.of(system_of(emulator).structure, emulator.dt)
    moves = unit > 0
    differences = frame.difference(steps.ends, np.asarray(emulated, float))
    return np.sqrt(np.mean((differences[:, moves] / unit[moves]) ** 2, axis=1))


class Seen(NamedTuple):
    """What an emulator makes of super steps."""

    features: np.ndarray
    units: np.ndarray
    outside: np.ndarray


def seen_by(emulator: Emulator, steps: SuperSteps) -> Seen:
    """Return what the network sees, its last units, and how far the farthest feature leaves its range, as a share of it."""

    def one(state: jax.Array, control: jax.Array) -> tuple[jax.Array, ...]:
        latent, held = emulator.encode(state), emulator.encode_control(control)
        raw = emulator.raw_features(latent, held)
        streams = emulator.features.streams(latent, emulator.normaliser.forward(raw))
        _, units, beyond = emulator.stride_and_units(latent, held)
        width = emulator.domain.high - emulator.domain.low
        share = jax.numpy.max(jax.numpy.abs(beyond) / jax.numpy.maximum(width, 1e-6))
        return jax.numpy.concatenate(streams), jax.numpy.concatenate(units), share

    inputs = (as_jax(steps.states), as_jax(steps.controls))
    return Seen(*(np.asarray(part, float) for part in jax.jit(jax.vmap(one))(*inputs)))


def mahalanobis(known: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return the distance from `known` rows by their covariance."""
    mean = known.mean(axis=0)
    covariance = np.cov(known.T)
    ridge = RIDGE * np.trace(covariance) / len(mean)
    root = np.linalg.cholesky(np.linalg.inv(covariance + ridge * np.eye(len(mean))))
    return lambda rows: np.linalg.norm((rows - mean) @ root, axis=1)


def heads(known: np.ndarray, errors: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return the disagreement of linear heads on `known` units, each fitted to `errors` (N, V) of a sample drawn anew."""
    rng = np.random.default_rng(0)
    known = np.c_[np.ones(len(known)), known]
    fitted = []
    for _ in range(HEADS):
        chosen = rng.integers(0, len(known), len(known))
        rows = known[chosen]
        gram = rows.T @ rows / len(rows)
        ridge = RIDGE * np.trace(gram) / len(gram)
        moment = rows.T @ errors[chosen] / len(rows)
        fitted.append(np.linalg.solve(gram + ridge * np.eye(len(gram)), moment))

    def disagreement(units: np.ndarray) -> np.ndarray:
        rows = np.c_[np.ones(len(units)), units]
        return np.stack([rows @ head for head in fitted]).std(axis=0).mean(axis=1)

    return disagreement


def auroc(scores: np.ndarray, is_large: np.ndarray) -> float:
    """Return how often a large error has a higher score than another (Mann and Whitney, 1947); ties count half."""
    _, ranks, counts = np.unique(scores, return_inverse=True, return_counts=True)
    middle = np.cumsum(counts) - (counts - 1) / 2
    large = int(is_large.sum())
    above = middle[ranks][is_large].sum() - large * (large + 1) / 2
    return float(above / (large * (len(scores) - large)))


class Draw(NamedTuple):
    """Super steps an emulator is judged by, drawn with one seed."""

    known: SuperSteps
    """As in training, for the baselines to be fitted to."""
    both: SuperSteps
    """As in training, then shifted ones."""
    usual: slice
    """Which of them are as in training."""
    beyond: slice
    unit: np.ndarray
    """Standard deviations of the usual change; 0 of what does not move."""
    errors: np.ndarray
    is_large: np.ndarray
    scores: np.ndarray

    @classmethod
    def of(cls, emulator: Emulator, seed: int) -> Draw:
        """Return what `seed` and the two after it give."""
        system = system_of(emulator)
        known = as_in_training(system, emulator.dt, seed)
        test = as_in_training(system, emulator.dt, seed + 1)
        away = shifted(system, emulator.dt, seed + 2)
        frame = Frame.of(system.structure, emulator.dt)
        unit = frame.difference(known.states, known.ends).std(axis=0)
        unit = np.where(unit > 1e-6, unit, 0)
        large_from = np.quantile(errors_of(emulator, test, unit), 0.95)
        both = test.joined(away)
        errors = errors_of(emulator, both, unit)
        scores = emulator.trust(both.states, both.controls)
        count = len(test.states)
        usual, beyond = slice(count), slice(count, None)
        return cls(known, both, usual, beyond, unit, errors, errors > large_from, scores)


def draws_of(name: str) -> list[dict[str, Any]]:
    """Return how well scores tell large errors, a line a draw; and with the distance of all features added to them."""
    emulator = load_emulator(name)
    rows = []
    for seed in DRAWS:
        draw = Draw.of(emulator, seed)
        known, both = seen_by(emulator, draw.known), seen_by(emulator, draw.both)
        distance = mahalanobis(known.features)
        edge = np.quantile(distance(known.features), 0.99)
        features = distance(both.features) / edge
        together = np.hypot(draw.scores, features)
        beyond = draw.beyond
        rows.append(
            {
                "emulator": name,
                "seed": seed,
                "auroc": auroc(draw.scores, draw.is_large),
                "auroc_shifted": auroc(draw.scores[beyond], draw.is_large[beyond]),
                "auroc_features": auroc(features, draw.is_large),
                "auroc_with_features": auroc(together, draw.is_large),
            }
        )
    return rows


def rows_of(name: str) -> dict[str, Any]:
    """Return an emulator's line of the table."""
    emulator = load_emulator(name)
    draw = Draw.of(emulator, FIRST_SEED)
    known, both, unit = draw.known, draw.both, draw.unit
    errors, is_large, scores = draw.errors, draw.is_large, draw.scores
    seen, new = seen_by(emulator, known), seen_by(emulator, both)
    frame = Frame.of(system_of(emulator).structure, emulator.dt)
    emulated = emulator.rollout(known.states, known.controls[:, None])[:, 1]
    moves = unit > 0
    residuals = frame.difference(known.ends, np.asarray(emulated, float))[:, moves] / unit[moves]
    usual, beyond = draw.usual, draw.beyond
    return {
        "emulator": name,
        "super_steps": len(both.states),
        "error_usual": float(np.sqrt(np.mean(errors[usual] ** 2))),
        "error_shifted": float(np.sqrt(np.mean(errors[beyond] ** 2))),
        "large_shifted": float(is_large[beyond].mean()),
        "auroc": auroc(scores, is_large),
        "auroc_usual": auroc(scores[usual], is_large[usual]),
        "auroc_shifted": auroc(scores[beyond], is_large[beyond]),
        "auroc_ranges": auroc(new.outside, is_large),
        "auroc_features": auroc(mahalanobis(seen.features)(new.features), is_large),
        "auroc_units": auroc(mahalanobis(seen.units)(new.units), is_large),
        "auroc_heads": auroc(heads(seen.units, residuals)(new.units), is_large),
        "within_edge_usual": float(np.mean(scores[usual] <= 1)),
        "within_edge_shifted": float(np.mean(scores[beyond] <= 1)),
        "large_within_edge": float(is_large[scores <= 1].mean()),
        "large_beyond_edge": float(is_large[scores > 1].mean()),
        **cost_of(emulator),
    }


def cost_of(emulator: Emulator) -> dict[str, float]:
    """Return what a super step costs in C on one core, and how much longer it takes with its score, medians of turns."""
    program = c_emulator(emulator)
    if program is None:
        return {"step_us": float("nan"), "score_share": float("nan")}
    rng = np.random.default_rng(0)
    dt = emulator.dt
    controls = np.float32(sample_control_runs(rng, 1, TIMED, dt, system_of(emulator)))
    start = np.float32(emulator.rest)[None]
    ways = (program.rollouts, program.rollouts_trusted)
    seconds: list[list[float]] = [[], []]
    for turn in range(2 * TURNS):
        began = time.perf_counter()
        ways[turn % 2](start, controls)
        seconds[turn % 2].append((time.perf_counter() - began) / TIMED)
    plain, trusted = (np.array(turns) for turns in seconds)
    return {
        "step_us": float(np.median(plain)) * 1e6,
        "score_share": float(np.median(trusted / plain)) - 1,
    }


PARTS = {
    "bounds": bounds.measure,
    "others": bounds.measure,
    "hybrid": hybrid.measure,
    "draws": draws_of,
}
"""What else is measured, by its name: functions from an emulator's name to rows of a table."""


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("words", nargs="*", metavar="PART | NAME", help="a part, then emulators")
    options = parser.parse_args()
    words = options.words
    measure = rows_alone
    table = TABLE
    usual = NAMES
    if words and words[0] in PARTS:
        measure = PARTS[words[0]]
        table = TABLE.with_name(f"trust_{words[0]}.csv")
        usual = OTHERS if words[0] == "others" else NAMES
        words = words[1:]
    names = words or usual
    rows: Rows = []
    with progress_bar("emulators", len(names)) as bar:
        for number, name in enumerate(names):
            rows.extend(measure(name))
            bar.advance_to(number + 1, name)
            if not words:  # of what takes ten minutes nothing shall be lost
                keep_rows(table, rows, options)
    show_rows(rows)


def rows_alone(name: str) -> list[dict[str, Any]]:
    """Return the only line of an emulator in the table of scores."""
    return [rows_of(name)]


if __name__ == "__main__":
    main()
