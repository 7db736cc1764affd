"""The recipes of the emulators that ship in the package: same data, same seeds, same weights on one machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import generate
from neuroanimator.data.store import read_transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.systems.loading import USUAL_SUBSTEPS
from neuroanimator.training.config import TrainingConfig
from neuroanimator.training.train import Report, train
from neuroanimator.zoo import shipped_path


@dataclass(frozen=True)
class Recipe:
    """What one system's emulators are trained on, and for how long."""

    widths: tuple[int, ...]
    transitions: int
    updates: int
    samples_per_run: Literal[12, 36] = 12
    """Examples from each run; 36 where contacts make rare events matter and physics is dear."""
    network: Literal["gated", "linear-glu"] = "gated"
    rare_share: float = 0.0
    """See `TrainingConfig`."""
    aside: float = 1.0
    """Share of transitions and updates for other super steps than of 50 physics steps."""
    idle_share: float = 0.0
    """Share of runs whose controls cease; nothing to learn where the mirror keeps rest at rest."""
    modes: tuple[int, int] = (1, 1)
    """How many shape modes describe positions and velocities; of deformable bodies."""

    def data(self, system: str, substeps: int) -> DatasetConfig:
        """Return the dataset to train on."""
        count = round(self.transitions * self._share(substeps))
        return DatasetConfig(
            system=system,
            substeps=substeps,
            count=count,
            samples_per_run=self.samples_per_run,
            idle_share=self.idle_share,
        )

    def _share(self, substeps: int) -> float:
        return 1.0 if substeps == USUAL_SUBSTEPS else self.aside

    def training(self, substeps: int, seed: int = 0) -> TrainingConfig:
        """Return how to train; `seed` 0 is the emulator that ships."""
        return TrainingConfig(
            network=self.network,
            widths=self.widths,
            updates=round(self.updates * self._share(substeps)),
            rare_share=self.rare_share,
            position_modes=self.modes[0],
            velocity_modes=self.modes[1],
            seed=seed,
        )


RECIPES = {
    "cube": Recipe(
        (96, 64),
        transitions=360_000,
        updates=60_000,
        samples_per_run=36,
        network="linear-glu",
        rare_share=0.5,
        modes=(18, 18),
        aside=0.5,
    ),
    "dolphin": Recipe(
        (96, 64),
        transitions=360_000,
        updates=80_000,
        samples_per_run=36,
        idle_share=0.15,
        modes=(28, 40),
        aside=0.5,
    ),
    "fish": Recipe(
        (64,),
        transitions=504_000,
        updates=100_000,
        samples_per_run=36,
        idle_share=0.15,
        modes=(36, 48),
        aside=0.5,
    ),
    "lander": Recipe(
        (64, 48), transitions=1_440_000, updates=120_000, samples_per_run=36, rare_share=0.5
    ),
    "pendulum": Recipe((96, 64), transitions=300_000, updates=300_000),
    "pendulum-passive": Recipe((64, 64), transitions=300_000, updates=300_000),
    "truck": Recipe((128, 96), transitions=480_000, updates=100_000, samples_per_run=36),
}


def cook(
    system: str,
    substeps: int,
    folder: Path,
    *,
    seed: int = 0,
    on_report: Callable[[Report], None] = lambda report: None,
) -> tuple[Emulator, Path]:
    """Return the emulator the recipe makes in `folder` and its file; a killed run goes on where it stopped."""
    recipe, data = RECIPES[system], folder / f"{system}-{substeps}"
    generate(recipe.data(system, substeps), data)
    name = shipped_path(system, substeps).name
    out = folder / (name if seed == 0 else name.replace(".emulator", f"-seed-{seed}.emulator"))
    return train(
        read_transitions(data), recipe.training(substeps, seed), out, on_report=on_report
    ), out
