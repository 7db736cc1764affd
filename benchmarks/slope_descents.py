"""Descents of one second: gain on the true physics within a second of one core, by gradients of an emulator and of the physics.

python benchmarks/slope_descents.py                     Hopper-v5, Walker2d-v5, Ant-v5, human
python benchmarks/slope_descents.py human --keep policies --dry

From states of the policies of walking_slopes.py, the controls of the next half second start from the policy's. Each iteration
takes one gradient, one step of Adam, and one rollout on the physics, which gives the return and the states for the next gradient.
After a second of one core's time, without compilation, the best return so far counts. `gain` is its excess over the policy's own
`return`, median and minimum over starts; `iterations` is the number of iterations. Gradients are the emulator's at true states,
central differences of the physics, and MJX's if `mujoco-mjx` is installed; `random` takes no gradient, but keeps random changes
of the best controls that improve them. Each has the best, by its median, of the rates in `RATES`.

Writes results/slope_descents.csv.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from following import RESULTS
from jaxtyping import Float
from walking_slopes import (
    BODIES,
    STARTS,
    Case,
    Slope,
    cases_of,
    difference_slope,
    folder_at,
    goes_on,
    paid,
    rolled_out,
    simulated,
    slopes_of,
)

from neuroanimator.evaluation.csv_table import merge_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.speed import one_core
from neuroanimator.terminal import print_table

Rows = list[dict[str, Any]]

HORIZON = 0.5
"""[s]"""

SECONDS = 1.0
"""Of one core's time, for each descent."""

RATES = (0.1, 0.3, 1.0)
"""Adam's step sizes, and standard deviations of random changes, in the noise's standard deviation."""

DECAYS = (0.9, 0.999)
"""Adam's, of the means of slopes and of their squares."""

TINY = 1e-8


class Descent(NamedTuple):
    """Result of one start."""

    first: float
    """Return of the policy's own controls."""
    gain: float
    """Increase of the return on the physics."""
    iterations: int


class Ascent:
    """Steps of Adam up a slope."""

    is_greedy = False

    def __init__(self, case: Case, slope: Slope, rate: float):
        self.case = case
        self.slope = slope
        self.rate = rate * case.spread
        self.count = 0
        self.mean: Any = 0.0
        self.square: Any = 0.0

    def __call__(self, controls: np.ndarray, states: np.ndarray) -> np.ndarray:
        slope = self.slope(controls, states, goes_on(self.case, states))
        first, second = DECAYS
        self.count += 1
        self.mean = first * self.mean + (1 - first) * slope
        self.square = second * self.square + (1 - second) * slope**2
        mean = self.mean / (1 - first**self.count)
        square = self.square / (1 - second**self.count)
        return controls + self.rate * mean / (np.sqrt(square) + TINY)


class RandomChanges:
    """Random changes of the best controls."""

    is_greedy = True

    def __init__(self, case: Case, rate: float):
        self.rate = rate * case.spread
        self.rng = np.random.default_rng(3)

    def __call__(self, controls: np.ndarray, states: np.ndarray) -> np.ndarray:
        return controls + self.rate * self.rng.normal(size=controls.shape)


def descended(
    case: Case,
    proposal: Ascent | RandomChanges,
    controls: Float[np.ndarray, "T C"],
    states: Float[np.ndarray, "T+1 S"],
) -> Descent:
    """Return the gain within `SECONDS` over `controls`, under which the physics goes through `states`."""
    bounds = case.policy.emulator.bounds
    first = best = float(paid(case, states[None], controls[None]).sum())
    iterations = 0
    began = time.process_time()
    while True:
        tried = bounds.clip(proposal(controls, states))
        moved = simulated(case, states[:1], tried[None])
        earned = float(paid(case, moved, tried[None]).sum())
        if time.process_time() - began > SECONDS:
            return Descent(first, best - first, iterations)
        iterations += 1
        if not proposal.is_greedy or earned > best:
            controls, states = tried, moved[0]
        best = max(best, earned)


def measured(case: Case) -> Rows:
    """Return a row for each kind of slope."""
    steps = case.steps(HORIZON)
    ways = [rolled_out(case, start, steps) for start in case.starts]
    slopes: dict[str, Slope | None] = {**slopes_of(case)}
    del slopes["imagined"]
    slopes["differences"] = difference_slope(case)
    slopes["random"] = None
    rows = []
    for name, slope in slopes.items():
        _proposal(case, slope, 0.0)(*ways[0])  # compiles it
        found = {}
        for rate in RATES:
            found[rate] = [descended(case, _proposal(case, slope, rate), *way) for way in ways]
        rows.append(_row(case, name, found))
    return rows


def _proposal(case: Case, slope: Slope | None, rate: float) -> Ascent | RandomChanges:
    if slope is None:
        return RandomChanges(case, rate)
    return Ascent(case, slope, rate)


def _row(case: Case, name: str, found: dict[float, list[Descent]]) -> dict[str, Any]:
    gains = {rate: np.array([one.gain for one in descents]) for rate, descents in found.items()}
    rate = max(gains, key=lambda rate: float(np.median(gains[rate])))
    return {
        "body": case.body,
        "policy": case.policy_name,
        "slope": name,
        "rate": rate,
        "return": float(np.median([one.first for one in found[rate]])),
        "gain": float(np.median(gains[rate])),
        "gain_least": float(gains[rate].min()),
        "iterations": int(np.median([one.iterations for one in found[rate]])),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("bodies", nargs="*", default=list(BODIES))
    parser.add_argument("--keep", type=Path, help="folder of the policies that are learnt")
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    print(describe_machine())
    file = RESULTS / "slope_descents.csv"
    for body in arguments.bodies:
        with folder_at(arguments.keep) as folder:
            for case in cases_of(body, folder, STARTS):
                with one_core():
                    rows = measured(case)
                print_table(rows)
                if not arguments.dry:
                    merge_csv(file, rows, "body", "policy", "slope")


if __name__ == "__main__":
    main()
