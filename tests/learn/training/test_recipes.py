"""Recipes: what ships is what they say, in strides where they ask for them."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroanimator.emulator.artifact import read_metadata
from neuroanimator.emulator.emulator import load_emulator
from neuroanimator.files.zoo import LARGE, SHIPPED, shipped_path
from neuroanimator.learn.training import recipes
from neuroanimator.learn.training.recipes import LARGE_RECIPES, RECIPES, Recipe
from tools.cook import cook


def test_strides_make_up_every_super_step_that_ships():
    rows = [(RECIPES[system], n) for system, n in SHIPPED]
    rows += [(LARGE_RECIPES[system], n) for system, n in LARGE]
    for recipe, substeps in rows:
        assert recipe.strides(substeps) * recipe.stride(substeps) == substeps
        assert recipe.stride(substeps) <= recipe.longest_stride


@pytest.mark.parametrize(("system", "substeps"), LARGE)
def test_a_large_emulator_is_what_its_recipe_makes(system: str, substeps: int):
    path = shipped_path(system, substeps, "large")
    recipe = LARGE_RECIPES[system]
    emulator = load_emulator(path)
    assert emulator.strides == recipe.strides(substeps)
    assert emulator.network.widths == recipe.widths
    dataset = read_metadata(path)["provenance"]["dataset"]
    assert dataset["substeps"] == recipe.stride(substeps)
    assert dataset["count"] == recipe.transitions


def test_a_recipe_with_strides_makes_one_emulator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    small = Recipe((8,), transitions=600, updates=250, longest_stride=25)
    monkeypatch.setitem(recipes.LARGE_RECIPES, "pendulum", small)
    emulator, path = cook("pendulum", 50, tmp_path, size="large")
    assert path.name == "pendulum-50-large.emulator.safetensors"
    assert (emulator.substeps, emulator.strides) == (50, 2)
    assert load_emulator(path).strides == 2
    assert read_metadata(path)["provenance"]["training"]["updates"] == 250
