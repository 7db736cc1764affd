"""Write how Python judges swims, which the page's judge is held against: `python studio/tests/vectors/write_verdicts.py`.

Each case is a start, controls and a place, and what the true physics makes of them: there and back up, not there, belly up.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from neuroanimator import load_emulator
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.learn.tasks.swimmers import body_length, gait_controls
from neuroanimator.state.pose import read_pose
from neuroanimator_studio.descents import Verdict, descent_of, judge_motion
from neuroanimator_studio.description import short_numbers

SWIMMERS = ("fish-50", "dolphin-50")

GAIT_STRENGTH = 0.7

PATH = Path(__file__).with_name("verdicts.json")


def swims(emulator: Emulator) -> list[dict[str, Any]]:
    """Return starts, controls and places."""
    system = system_of(emulator)
    descent = descent_of(emulator, system)
    assert descent is not None
    steps = descent.problem.parametrisation.steps
    controls = GAIT_STRENGTH * gait_controls(system, steps, emulator.dt)
    aside = np.array([0.0, 0.5 * body_length(system), 0.0])
    upright = np.array(system.rest, float)
    belly_up = (upright.reshape(-1, 3) * (1, -1, -1)).ravel()
    rows = []
    for start, away in ((upright, 0 * aside), (upright, aside), (belly_up, 0 * aside)):
        end = system.simulate_fastest(start[None], controls[None], emulator.dt).states[0, -1]
        place = read_pose(system.structure, end).position + away
        numbers = {"start": start, "controls": controls, "place": place}
        rows.append({name: short_numbers(one) for name, one in numbers.items()})
    return rows


def verdict_on(emulator: Emulator, swim: dict[str, Any]) -> Verdict:
    """Return what Python says of a swim on the true physics."""
    system = system_of(emulator)
    start, controls = np.array(swim["start"]), np.array(swim["controls"])
    states = system.simulate_fastest(start[None], controls[None], emulator.dt).states[0]
    return judge_motion(emulator, system, {"place": swim["place"]}, states)


def cases() -> list[dict[str, Any]]:
    """Return every case."""
    rows = []
    for name in SWIMMERS:
        emulator = load_emulator(name)
        for swim in swims(emulator):
            verdict = verdict_on(emulator, swim)
            rows.append({"bundle": name, **swim, "is_success": verdict.is_success, "words": verdict.words})  # fmt: skip
    return rows


if __name__ == "__main__":
    lines = ",\n".join(json.dumps(row) for row in cases())
    PATH.write_text(f"[\n{lines}\n]\n")
