"""Emulators of single bodies and of their families, and what making them costs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.harness import Clocks
from neuroanimator import TrainingConfig, load_emulator
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import generate, simulate_transitions
from neuroanimator.learn.data.store import read_transitions
from neuroanimator.learn.training.train import read_metrics, run_folder, train
from neuroanimator.physics.loading import resolve, trust_files

FILES = Path(__file__).parent
"""The folder of the arm and its definitions."""

SAMPLE = 20_000
"""Number of transitions by which the time of simulating data is measured."""

LONG_RECIPE = {"widths": (192, 128), "updates": 80_000}


class Case(NamedTuple):
    """An emulator of the table."""

    name: str
    system: str
    """A TOML file beside this module; or a system that ships, with its emulator."""
    transitions: int
    training: dict[str, Any]
    """What of the training is not as usual."""

    @property
    def of(self) -> str:
        """What it is of: "body" or "family"."""
        return "family" if self.system.endswith("family.toml") else "body"


BODY = Case("a300", "arm.toml", 300_000, {})
FAMILY = Case("f300", "family.toml", 300_000, {})
WIDE_FAMILY = Case("f300w", "family.toml", 300_000, {"widths": (192, 128), "updates": 40_000})
LARGE_FAMILY = Case("f1m", "family.toml", 1_000_000, LONG_RECIPE)

CASES = (BODY, FAMILY, WIDE_FAMILY, LARGE_FAMILY)
"""Emulators of an arm whose first and last link can touch; the last one identifies."""

SHORT_RECIPE = {"updates": 20_000}

CARRIER_FAMILY = Case("carriers100", "carrier_family.toml", 100_000, SHORT_RECIPE)

CARRIER_RECIPE = {"widths": (192, 128), "updates": 60_000}

CARRIER_CASES = (
    Case("carrier100", "carrier.toml", 100_000, SHORT_RECIPE),
    CARRIER_FAMILY,
    Case("carriers300w", "carrier_family.toml", 300_000, CARRIER_RECIPE),
    Case("carrier300w", "carrier.toml", 300_000, CARRIER_RECIPE),
)
"""Emulators of an arm by URDF with a payload: six parameters, masses and dampings."""

HALF_RECIPE = {"updates": 10_000}

CARRIER_DATA_CASES = (
    Case("carrier100h", "carrier.toml", 100_000, HALF_RECIPE),
    Case("carriers100h", "carrier_family.toml", 100_000, HALF_RECIPE),
    Case("carriers100r", "carrier_family.toml", 100_000, HALF_RECIPE | {"rare_share": 0.3}),
    Case("carriers300h", "carrier_family.toml", 300_000, HALF_RECIPE),
    Case("carrier300h", "carrier.toml", 300_000, HALF_RECIPE),
)
"""The same with half of the updates: what data do, and rare super steps drawn more often, each by itself."""

TRUCK_RECIPE = {"widths": (128, 96), "updates": 100_000}
TRUCKS_RECIPE = {"widths": (128, 96), "updates": 40_000}
WIDE_TRUCKS_RECIPE = {"widths": (192, 128), "updates": 27_000}

TRUCK_CASES = (
    Case("truck-50", "truck", 480_000, TRUCK_RECIPE),
    Case("trucks480", "truck_family.toml", 480_000, TRUCKS_RECIPE),
    Case("trucks480w", "truck_family.toml", 480_000, WIDE_TRUCKS_RECIPE),
)
"""Emulators of the truck that ships, and of trucks of other masses on other ground."""

SYSTEMS = {
    "arm": CASES,
    "arm by URDF": CARRIER_CASES,
    "arm by URDF, short training": CARRIER_DATA_CASES,
    "truck": TRUCK_CASES,
}
"""Cases of the table by system; the first of each is of one body."""


class Made(NamedTuple):
    """An emulator and what it cost; not numbers where it ships."""

    emulator: Emulator
    updates: int
    data_seconds: float
    training_seconds: float


def made(case: Case, folder: Path) -> Made:
    """Return the emulator of `case`: the one that ships, or from `folder` if it lies there, else made and put there.

    The time of simulating its data is that of `SAMPLE` transitions, scaled.
    """
    if not case.system.endswith(".toml"):
        emulator = load_emulator(case.name)
        return Made(emulator, case.training["updates"], math.nan, math.nan)
    toml = FILES / case.system
    trust_files(toml)
    path = folder / f"{case.name}.emulator.safetensors"
    if not path.exists():
        make(case, path)
    reports = read_metrics(run_folder(path) / "metrics.jsonl")
    name, definition, substeps = resolve(str(toml))
    sample = DatasetConfig.usual(name, definition, substeps, count=SAMPLE, seed=1)
    began = Clocks.now()
    simulate_transitions(sample)
    data_seconds = began.passed().seconds * case.transitions / SAMPLE
    return Made(load_emulator(path), reports[-1].update, data_seconds, reports[-1].seconds)


def make(case: Case, path: Path) -> None:
    """Simulate the data of `case`, unless another case has had them made, and train."""
    name, definition, substeps = resolve(str(FILES / case.system))
    config = DatasetConfig.usual(name, definition, substeps, count=case.transitions)
    data_folder = path.with_name(f"{name}-{case.transitions}.data")
    generate(config, data_folder)
    data = read_transitions(data_folder)
    settings = TrainingConfig.usual(data.system.structure, **case.training)
    train(data, settings, path)
