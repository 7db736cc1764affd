"""From a goal to a controller proved on the physics: descend, replay, refine, again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from neuroanimator.control.descend import Descent, descend
from neuroanimator.control.objective import GOALS, Objective, is_reached, reach_state
from neuroanimator.control.refine import transitions_near
from neuroanimator.control.replay import Replay, is_upright, replay
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.transitions import Transitions, dataset_config
from neuroanimator.emulator.artifact import describe
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.errors import ArgumentError
from neuroanimator.systems import load_system
from neuroanimator.systems.system import System
from neuroanimator.training.config import training_config
from neuroanimator.training.train import train

LARGE_GAP = 0.5
"""A gap of J above this is worth refining: half of what one end-state number off by its scale costs."""
NEARBY = 4_000
"""Physics windows added per refinement: 0.8 s of data in about two seconds."""
FRESH = 24_000
"""Transitions simulated to keep the rest of the emulator in shape while it learns the motion."""
LONGEST = 20.0
"""[s] Longest motion searched for."""
REFINING_UPDATES = 5_000
REFINING_RATE = 1e-3


@dataclass(frozen=True)
class Synthesis:
    """A controller and how it came about."""

    emulator: Emulator
    """The one that found it: refined if refining was needed."""
    descent: Descent
    outcome: Replay
    refinements: int
    is_reached: bool | None = None
    """Whether the physics ends within the goal's tolerances; None where no named goal was asked for."""


def synthesise(
    emulator: Emulator,
    system: System,
    objective: Objective,
    start: np.ndarray,
    *,
    steps: int,
    method: str = "gauss-newton",
    iterations: int = 20,
    data: Transitions | None = None,
    refinements: int = 2,
    on_refine: Callable[[float], None] = lambda gap: None,
) -> Synthesis:
    """Return the best controller by its J on the physics, among the first and up to `refinements` more.

    While the physics disagrees with the emulator, transitions around the motion are added to `data`
    (what the emulator was trained on; simulated anew if not given), and a copy of the emulator trains on.
    """
    done = 0
    descent = descend(emulator, objective, start, steps=steps, method=method, iterations=iterations)
    best = Synthesis(emulator, descent, replay(emulator, system, objective, start, descent.controls), 0)
    found = best
    while done < refinements and found.outcome.gap > LARGE_GAP:
        on_refine(found.outcome.gap)
        done += 1
        data = data or simulate_transitions(
            dataset_config(
                system=system.name, definition=system.definition, substeps=emulator.identity.substeps, count=FRESH
            )
        )
        data = transitions_near(data, found.outcome.physical, found.descent.controls, count=NEARBY, seed=done)
        refined = _train_on(found.emulator, data)
        descent = descend(
            refined,
            objective,
            start,
            steps=steps,
            method=method,
            iterations=iterations,
            first=found.descent.controls,
        )
        found = Synthesis(refined, descent, replay(refined, system, objective, start, descent.controls), done)
        if found.outcome.cost_physics < best.outcome.cost_physics:
            best = found
    return best


def synthesise_goal(
    emulator: Emulator, goal: str, seconds: float | None = None, *, effort_weight: float = 1.0, **options: Any
) -> Synthesis:
    """Return the controller that reaches the named `goal` from rest in `seconds`; options as `synthesise`.

    `seconds` defaults to what the goal itself says is sensible.
    """
    system = load_system(emulator.identity.system, emulator.identity.definition)
    if not 0 <= effort_weight < float("inf"):
        raise ArgumentError(f"effort_weight: wanted a finite number of at least 0, came {effort_weight:g}.")
    objective, verdict, usual = find_goal(system, goal, effort_weight)
    seconds = usual if seconds is None else seconds
    if not emulator.dt <= seconds <= LONGEST:
        raise ArgumentError(f"seconds: wanted between {emulator.dt:g} and {LONGEST:g}, came {seconds:g}.")
    found = synthesise(emulator, system, objective, system.rest, steps=round(seconds / emulator.dt), **options)
    return Synthesis(
        found.emulator, found.descent, found.outcome, found.refinements, verdict(found.outcome.physical[-1])
    )


def find_goal(
    system: System, name: str, effort_weight: float = 1.0
) -> tuple[Objective, Callable[[np.ndarray], bool], float]:
    """Return (objective, whether a state fulfils it, usual length [s]) of the system's goal called `name`."""
    if system.name == "pendulum" and name in GOALS:
        return GOALS[name](effort_weight=effort_weight), is_upright, SWING_SECONDS
    if name in system.goals:
        goal = system.goals[name]
        objective = reach_state(system.structure, system.rest, goal, effort_weight)
        return objective, lambda state: is_reached(system, goal, state), goal.seconds
    names = ", ".join(sorted([*system.goals, *(GOALS if system.name == "pendulum" else ())]))
    raise ArgumentError(f"No goal called '{name}' for the system {system.name}. Goals: {names or 'none'}.")


SWING_SECONDS = 1.5
"""As long as a quick human arm takes; the motors could do it in one."""


def _train_on(emulator: Emulator, data: Transitions) -> Emulator:
    network = emulator.network
    config = training_config(
        widths=network.widths,
        network=describe(emulator)["network"]["kind"],
        updates=REFINING_UPDATES,
        learning_rate=REFINING_RATE,
        unroll_share=0.5,
    )
    with TemporaryDirectory() as folder:  # seconds of training: not worth resuming
        return train(data, config, Path(folder) / "refined.emulator.safetensors", start_from=emulator)
