"""The data and the training that a plan means: the recipes of what ships, or what is usual for somebody's own system."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from neuroanimator import DatasetConfig, System, TrainingConfig
from neuroanimator.authoring import LARGE_RECIPES, RECIPES, Recipe, resolve
from neuroanimator_studio.job_plan import MIN_COUNT, MIN_UPDATES, MODEL, Plan

SHARES = {"sketch": 0.1, "usual": 1.0, "large": 2.0}
"""How much of the usual data and updates each size takes."""


def data_of(plan: Plan, folder: Path) -> DatasetConfig:
    """Return what to simulate; `folder` is the job's."""
    if _has_recipe(plan, folder):
        return _recipe(plan).data(plan.system, plan.substeps)
    toml = folder / MODEL
    name, definition, _ = resolve(str(toml) if toml.is_file() else plan.system)
    usual = DatasetConfig.usual(name, definition, plan.substeps)
    return usual.model_copy(update={"count": _count(plan, usual.count)})


def training_of(plan: Plan, folder: Path, system: System) -> TrainingConfig:
    """Return how to train on data of that `system`."""
    if _has_recipe(plan, folder):
        return _recipe(plan).training(plan.substeps)
    usual = TrainingConfig.usual(system.structure)
    return usual.model_copy(update={"updates": _updates(plan, usual.updates)})


def _has_recipe(plan: Plan, folder: Path) -> bool:
    return not (folder / MODEL).is_file() and plan.system in RECIPES


def _recipe(plan: Plan) -> Recipe:
    """Return the recipe of what ships, of the plan's size."""
    usual = RECIPES[plan.system]
    widths = LARGE_RECIPES[plan.system].widths if plan.size == "large" else usual.widths
    return replace(
        usual,
        widths=widths,
        transitions=_count(plan, usual.transitions),
        updates=_updates(plan, usual.updates),
        aside=1.0,
    )


def _count(plan: Plan, usual: int) -> int:
    return plan.count or max(MIN_COUNT, round(usual * SHARES[plan.size]))


def _updates(plan: Plan, usual: int) -> int:
    return plan.updates or max(MIN_UPDATES, round(usual * SHARES[plan.size]))
