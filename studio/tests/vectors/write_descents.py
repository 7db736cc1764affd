"""Write what descents in Python find, which those in the page are held against: `python studio/tests/vectors/write_descents.py`.

Each case is a bundle's descent with what may be moved at random: J after every iteration, by the methods of Python.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator import load_emulator
from neuroanimator.control.descent.descend import evaluator_of
from neuroanimator.control.descent.methods import METHODS
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator_studio.descent_module import ITERATIONS, PageDescent
from neuroanimator_studio.descents import WITH_DESCENT, descent_of

CASES = 3
"""Of each bundle; the first one is what the page begins with."""

PATH = Path(__file__).with_name("descents.json")


def costs_of(descent: PageDescent, values: dict[str, list[float]]) -> list[float]:
    """Return the least J at first and after each iteration, as the page descends."""
    evaluator = evaluator_of(descent.moved(values))
    method = METHODS["gauss-newton"]
    costs = [float(evaluator.costs(descent.guesses).min())]
    starts = [method.begin(guess) for guess in descent.guesses]
    while not all(start.is_done or start.sweeps == ITERATIONS for start in starts):
        starts = [start if start.is_done else method.iterate(evaluator, [start])[0] for start in starts]  # fmt: skip
        costs.append(min(start.least for start in starts))
    return costs


def moved(descent: PageDescent, rng: np.random.Generator) -> dict[str, list[float]]:
    """Return random values of the places that may be moved; weights stay as they are."""
    values = {}
    for movable in descent.movable:
        if movable.kind == "place":
            values[movable.name] = rng.uniform(movable.low, movable.high).round(3).tolist()
    return values


def cases() -> list[dict[str, Any]]:
    """Return every case."""
    rows = []
    for name in WITH_DESCENT:
        emulator = load_emulator(name)
        descent = descent_of(emulator, system_of(emulator))
        assert descent is not None
        rng = np.random.default_rng(0)
        for number in range(CASES):
            values = moved(descent, rng) if number else {}
            costs = [float(f"{cost:.6g}") for cost in costs_of(descent, values)]
            rows.append({"bundle": name, "values": values, "costs": costs})
    return rows


if __name__ == "__main__":
    lines = ",\n".join(json.dumps(row) for row in cases())
    PATH.write_text(f"[\n{lines}\n]\n")
