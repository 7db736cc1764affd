"""Make the emulators that ship in the package, by their recipes.

python -m tools.train_shipped                    every one, about two hours on 2 cores
python -m tools.train_shipped pendulum 50        one of them
python -m tools.train_shipped pendulum 50 large  the same in its large size
python -m tools.train_shipped cape               a soft body, about an hour
python -m tools.train_shipped trust [NAME...]    trust of those that ship, measured again on unseen runs
python -m tools.train_shipped bounds [NAME...]   their error bounds, in the same way; after `trust`, half an hour
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.trust.task_motions import task_motions
from neuroanimator.emulator.artifact import read_metadata, save
from neuroanimator.emulator.emulator import load_emulator
from neuroanimator.files.zoo import LARGE, SHIPPED, SOFT, emulator_name, shipped_path
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.learn.training.error_fitting import fit_error_bounds
from neuroanimator.learn.training.recipes import LARGE_RECIPES, RECIPES
from neuroanimator.learn.training.trust_fitting import fit_trust
from neuroanimator.physics.loading import USUAL_SUBSTEPS
from tools.cook import cook, cook_soft

WORKPLACE = Path("out/shipped")

UNSEEN = {"count": 14_400, "samples_per_run": 36, "seed": 1}
"""What meters are fitted to: a small dataset as they were trained on, of another seed."""

BOUNDS_RUNS = {"random_runs": 2048, "optimised_runs": 1024}
"""Runs by which errors of the emulators that are used if nothing else is said are bounded."""

FEWER_RUNS = {"random_runs": 1024, "optimised_runs": 512}
"""Of other sizes and super steps."""

TRIALS = 48
"""Of each task of a system, besides; a quarter of them of other sizes and super steps."""

MORE_RUNS = {"lander": 2}
"""Factor by which there are more of all where errors are spread most: touchdowns are rare and make the largest."""

ALWAYS_MANY = ("lander",)
"""Of these every size and super step is measured as the usual one is: with fewer, touchdowns were too few, and 83 to 86 % of new
motions of controllers were below bounds of 90 %."""

MORE_TRIALS = {"lander": 2, "fish": 4, "dolphin": 4}
"""Factor by which there are more trials: swimmers' take hundredths of a second."""


def bound_shipped(system: str, substeps: int, size: str) -> None:
    """Give the emulator that ships the bounds of its errors; nothing else of its file changes."""
    path = shipped_path(system, substeps, size)
    emulator = load_emulator(path)
    is_usual = substeps == USUAL_SUBSTEPS and not size
    has_many = is_usual or system in ALWAYS_MANY
    more_runs = MORE_RUNS.get(system, 1)
    trials = range(MORE_TRIALS.get(system, 1) * (TRIALS if has_many else TRIALS // 4))
    runs = BOUNDS_RUNS if has_many else FEWER_RUNS
    counts = {kind: more_runs * count for kind, count in runs.items()}
    motions = task_motions(emulator, system_of(emulator), trials)
    more = () if motions is None else (motions,)
    fitted = fit_error_bounds(emulator, more_optimised=more, **counts)
    save(fitted, path, read_metadata(path)["provenance"])
    print(path.name, f"{path.stat().st_size:,} bytes", flush=True)


def fit_shipped(system: str, substeps: int, size: str) -> None:
    """Give the emulator that ships the meter of what it knows; nothing else of its file changes."""
    path = shipped_path(system, substeps, size)
    recipe = (LARGE_RECIPES if size else RECIPES)[system]
    config = DatasetConfig(**{**recipe.data(system, substeps).model_dump(), **UNSEEN})
    fitted = fit_trust(load_emulator(path), simulate_transitions(config))
    save(fitted, path, read_metadata(path)["provenance"])
    print(path.name)


def make_shipped(system: str, substeps: int, size: str) -> None:
    """Train the emulator that ships by its recipe."""
    _, made = cook(system, substeps, WORKPLACE, size=size, on_report=print)
    shipped_path(system, substeps, size).write_bytes(made.read_bytes())


def make_soft(system: str) -> None:
    """Train the emulator of a soft body that ships."""
    made = cook_soft(system, WORKPLACE, on_report=print)
    shipped_path(system, dict(SOFT)[system]).write_bytes(made.read_bytes())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("words", nargs="*", metavar="WORD", help="as above")
    words = parser.parse_args().words
    verb = words[0] if words else ""
    names = words[1:]
    if verb in dict(SOFT):
        make_soft(verb)
        return
    usual = [(system, substeps, "") for system, substeps in SHIPPED]
    large = [(system, substeps, "large") for system, substeps in LARGE]
    chosen = usual + large
    verbs = {"trust": fit_shipped, "bounds": bound_shipped}
    if names and verb in verbs:
        chosen = [one for one in chosen if emulator_name(*one) in names]
    elif names:
        chosen = [(verb, int(names[0]), "".join(names[1:]))]
    elif verb and verb not in verbs:
        parser.error(f"{verb} is no soft body, 'trust' or 'bounds'; for a system give n, too.")
    make = verbs.get(verb, make_shipped)
    for one in chosen:
        make(*one)


if __name__ == "__main__":
    main()
