"""The recipes of the shipped emulators; the file of each says which optimiser it was made by."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from neuroanimator.files.zoo import SHIPPED_SYSTEMS
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.physics.loading import USUAL_SUBSTEPS


@dataclass(frozen=True)
class Recipe:
    """The data and the length of training of one system's emulators."""

    widths: tuple[int, ...]
    transitions: int
    updates: int
    samples_per_run: Literal[12, 36] = 12
    """Number of examples from each run; 36 if contacts make rare events matter and physics is expensive."""
    rare_share: float = 0.0
    """See `TrainingConfig`."""
    aside: float = 1.0
    """Share of transitions and updates for super steps of other than 50 physics steps."""
    idle_share: float = 0.0
    """Share of runs whose controls end; not needed if the mirror symmetry keeps rest at rest."""
    held_share: float = 0.0
    """Share of runs whose controls stay at their bounds: see `DatasetConfig`."""
    calm: float = 0.0
    """See `TrainingConfig`."""
    modes: tuple[int, int] = (1, 1)
    """Numbers of shape modes of deformable bodies for positions and for velocities."""
    longest_stride: int = 1000
    """Maximum number of physics steps the network leaps: longer super steps are made in strides, see `Emulator.in_strides`."""

    def strides(self, substeps: int) -> int:
        """Return the number of strides in a super step of `substeps` physics steps."""
        return -(-substeps // self.longest_stride)

    def stride(self, substeps: int) -> int:
        """Return the number of physics steps in a stride of such a super step."""
        return substeps // self.strides(substeps)

    def data(self, system: str, substeps: int) -> DatasetConfig:
        """Return the dataset to train on, whose super steps are strides of `substeps` physics steps."""
        count = round(self.transitions * self._share(substeps))
        return DatasetConfig(
            system=system,
            substeps=substeps,
            count=count,
            samples_per_run=self.samples_per_run,
            idle_share=self.idle_share,
            held_share=self.held_share,
        )

    def _share(self, substeps: int) -> float:
        return 1.0 if substeps == USUAL_SUBSTEPS else self.aside

    def training(self, substeps: int, seed: int = 0) -> TrainingConfig:
        """Return the training on strides of `substeps` physics steps; `seed` 0 gives the shipped emulator."""
        return TrainingConfig(
            widths=self.widths,
            updates=round(self.updates * self._share(substeps)),
            rare_share=self.rare_share,
            calm=self.calm,
            position_modes=self.modes[0],
            velocity_modes=self.modes[1],
            seed=seed,
        )


RECIPES = {
    name: Recipe(**system.recipe)
    for name, system in SHIPPED_SYSTEMS.items()
    if system.recipe and not system.is_soft
}
"""Recipes of the usual size, by system."""

LARGE_RECIPES = {
    name: replace(RECIPES[name], **system.large)
    for name, system in SHIPPED_SYSTEMS.items()
    if system.large
}
"""Recipes of the large size, by system."""
