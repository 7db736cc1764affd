"""Parts of deformables.py about emulators: accuracy, stability, flat or in a hierarchy."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import equinox as eqx
import jax
import numpy as np
from deformable_cases.long_run import measure_long_run
from deformable_cases.spring_relaxation import relaxed
from deformable_cases.swims import compare_swims

from neuroanimator import Emulator, load_emulator, load_system
from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.store import Transitions
from neuroanimator.evaluation.accuracy import one_step_error, root_mean_square
from neuroanimator.evaluation.csv_table import quartiles
from neuroanimator.evaluation.held_out import HeldOut, held_out_runs
from neuroanimator.evaluation.speed import TIMED_SUPER_STEPS, emulator_player, interleaved, one_core
from neuroanimator.evaluation.stability import count_diverged
from neuroanimator.systems.deformable.deformable_system import DeformableSystem
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.train import train

Rows = list[dict[str, Any]]
COUNTS = (25, 50, 100)
"""The n of the emulators."""

SWIMS = 64
"""Number of random swims compared with the physics."""

SWIM_STEPS = 100
"""Length of a swim [super steps]."""

LONG_STARTS = 100
"""Number of bodies that swim for long."""

LONG_STEPS = 100_000
"""Number of super steps for which they swim."""

DIGITS = 2
"""Number of digits of quartiles."""

KNOWN_RUNS = 36 * 1_000
"""Training states a long run is measured against."""


def deformable(name: str) -> DeformableSystem:
    """Return the system of that name."""
    system = load_system(name)
    assert isinstance(system, DeformableSystem)
    return system


def accuracy_rows(repeats: int) -> Rows:
    """Return a row per shipped emulator: one step, a hundred steps, and what its modes cannot show."""
    names = [f"{name}-{n}" for name in ("fish", "dolphin") for n in COUNTS]
    return [accuracy_row(load_emulator(name), quick=repeats < 5) for name in names]


def accuracy_row(emulator: Emulator, *, quick: bool) -> dict[str, Any]:
    """Return the errors of one emulator; quartiles are over swims."""
    system = deformable(emulator.system)
    test = held_out_runs(emulator, 8 if quick else 32)
    swims = compare_swims(emulator, system, 16 if quick else SWIMS, SWIM_STEPS)
    errors = one_step_error(emulator, test)
    size = 3 * len(system.body.masses)
    return {
        "system": system.name,
        "substeps": emulator.substeps,
        "one_step_error": float(root_mean_square(errors)),
        "places": float(root_mean_square(errors[:size])),
        "speeds": float(root_mean_square(errors[size:])),
        "least_with_these_modes": least_error(emulator, test),
        "shape_error_100": float(np.median(swims.shape[:, -1])),
        "shape_quartiles": quartiles(swims.shape[:, -1], DIGITS),
        "place_error_100": float(np.median(swims.position[:, -1])),
        "place_quartiles": quartiles(swims.position[:, -1], DIGITS),
        "turn_error_100_deg": float(np.degrees(np.median(swims.orientation[:, -1]))),
        "way_m": float(np.median(swims.travelled[:, -1])),
        "diverged_of_1000": count_diverged(emulator, 100 if quick else 1000, SWIM_STEPS),
    }


def least_error(emulator: Emulator, test: HeldOut) -> float:
    """Return the one-step error of the true next states, shown by the emulator's modes alone."""
    truth = test.transitions.next_states
    shown = np.asarray(emulator.decode(np.asarray(emulator.encode(truth))))
    return float(
        root_mean_square(test.frame.difference(truth, shown) / test.change_scale, axis=(0, 1))
    )


def long_rows(repeats: int) -> Rows:
    """Return a row per system and correction: `LONG_STEPS` super steps against what training showed."""
    quick = repeats < 5
    rows = []
    for name in ("fish", "dolphin"):
        emulator = load_emulator(f"{name}-50")
        system = deformable(name)
        known = simulate_transitions(
            DatasetConfig(system=name, count=KNOWN_RUNS // (20 if quick else 1), samples_per_run=36)
        )
        states = known.states.reshape(-1, known.states.shape[-1])
        steps = 2_000 if quick else LONG_STEPS
        corrections = {
            "none": (None, False),
            "bounded by what training showed (the default)": (None, True),
            "3 relaxation steps of the springs, every 10": (relaxed(emulator, system.body), False),
            "both": (relaxed(emulator, system.body), True),
        }
        for label, (correction, is_bounded) in corrections.items():
            rows.append(
                long_row(
                    emulator, system, states, label, correction, steps, is_bounded, quick=quick
                )
            )
    return rows


def long_row(
    emulator, system, states, label, correction, steps, is_bounded, *, quick: bool
) -> dict[str, Any]:
    """Return one row of `long_rows`."""
    began = time.perf_counter()
    starts = 20 if quick else LONG_STARTS
    every = 10 if correction else 1
    found = measure_long_run(
        emulator,
        system,
        states,
        correction,
        every=every,
        is_bounded=is_bounded,
        starts=starts,
        steps=steps,
    )
    return {
        "system": system.name,
        "correction": label,
        "super_steps": steps,
        "alive": f"{found.alive}/{found.starts}",
        "inside_110_percent": f"{found.inside}/{found.starts}",
        **{f"worst_{key}": value for key, value in found.worst.items()},
        **{f"typical_{key}": value for key, value in found.typical.items()},
        "seconds": time.perf_counter() - began,
    }


FLAT = {
    "mirrored 64": {"widths": (64,)},
    "mirrored 64-48": {"widths": (64, 48)},
    "mirrored 96-64": {"widths": (96, 64)},
}
DEEP = {
    "hierarchy 48 / 16": {"widths": (48, 0, 16)},
    "hierarchy 64 / 24": {"widths": (64, 0, 24)},
}
LOCAL_MODES = 8
HIERARCHY_EXAMPLES, HIERARCHY_UPDATES = 200_016, 12_000


def hierarchy_rows(repeats: int) -> Rows:
    """Return a row per network: flat ones on modes of the whole body, hierarchies on modes of its segments."""
    quick = repeats < 5
    rows = []
    for name, modes in (("fish", (32, 44)), ("dolphin", (28, 40))):
        examples = HIERARCHY_EXAMPLES // (20 if quick else 1)
        data = simulate_transitions(DatasetConfig(system=name, count=examples, samples_per_run=36))
        flat = {
            label: {**each, "position_modes": modes[0], "velocity_modes": modes[1]}
            for label, each in FLAT.items()
        }
        deep = {
            label: {**each, "network": "hierarchy", "local_modes": LOCAL_MODES}
            for label, each in DEEP.items()
        }
        updates = 1_000 if quick else HIERARCHY_UPDATES
        found = {
            label: trained(data, updates, settings) for label, settings in {**flat, **deep}.items()
        }
        rows += compared(name, found)
    return rows


def trained(data: Transitions, updates: int, settings: dict[str, Any]) -> Emulator:
    """Return a freshly trained emulator."""
    with TemporaryDirectory() as folder:
        return train(
            data,
            TrainingConfig(updates=updates, **settings),
            Path(folder) / "one.emulator.safetensors",
        )


def compared(name: str, found: dict[str, Emulator]) -> Rows:
    """Return a row per emulator, tested on the same runs, timed in turn; and which wins at its cost."""
    with one_core():
        spans = interleaved(
            {label: emulator_player(emulator) for label, emulator in found.items()}, 15
        )
    rows = []
    for label, emulator in found.items():
        test = held_out_runs(emulator, 32)
        arrays = jax.tree.leaves(eqx.filter(emulator.network, eqx.is_array))
        rows.append(
            {
                "system": name,
                "network": label,
                "weights": sum(array.size for array in arrays),
                "numbers": emulator.normaliser.unit.shape[0],
                "super_step_us": spans[label] / TIMED_SUPER_STEPS * 1e6,
                "one_step_error": float(root_mean_square(one_step_error(emulator, test))),
                "least_with_these_modes": least_error(emulator, test),
            }
        )
    for row in rows:
        cheaper = [other for other in rows if other["super_step_us"] <= row["super_step_us"] * 1.05]
        row["best_at_its_cost"] = min(cheaper, key=lambda other: other["one_step_error"])["network"]
    return rows
