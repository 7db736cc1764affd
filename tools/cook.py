"""The emulators that ship, made by their recipes: same data, same seeds, same weights on one machine."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

from neuroanimator.emulator.artifact import read_metadata, save
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.files.zoo import SHIPPED_SYSTEMS, emulator_name, shipped_path
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import generate
from neuroanimator.learn.data.store import read_transitions
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.error_fitting import fit_error_bounds
from neuroanimator.learn.training.recipes import LARGE_RECIPES, RECIPES
from neuroanimator.learn.training.train import Report, train
from neuroanimator.physics import load_system
from neuroanimator.physics.loading import resolve, trust_files


@dataclass(frozen=True)
class SoftRecipe:
    """The data and the length of training of a soft body's emulator; the rest is as for users' soft bodies."""

    transitions: int
    updates: int
    widths: tuple[int, ...] | None = None
    """Units in each layer; the usual ones of such a body if not given."""
    unroll_share: float | None = None
    """See `TrainingConfig`: windows from the first update on are more accurate for cloths, single steps first for solids;
    the usual share of such a body if not given."""


SOFT_RANDOM_RUNS = 256
"""Number of runs along random paths for error bounds of soft bodies, whose physics is expensive."""

SOFT_OPTIMISED_RUNS = 128
"""Number of runs under controls found by descents, for the same."""

SOFT_RECIPES = {
    name: SoftRecipe(**system.recipe) for name, system in SHIPPED_SYSTEMS.items() if system.is_soft
}


def cook(
    system: str,
    substeps: int,
    folder: Path,
    *,
    size: str = "",
    seed: int = 0,
    on_report: Callable[[Report], None] = lambda report: None,
) -> tuple[Emulator, Path]:
    """Return the emulator the recipe makes in `folder` and its file; a killed run is resumed.

    `size` is "large", or empty for the usual one.
    """
    recipe = LARGE_RECIPES[system] if size == "large" else RECIPES[system]
    strides = recipe.strides(substeps)
    stride = recipe.stride(substeps)
    data = folder / emulator_name(system, stride, size)
    generate(recipe.data(system, stride), data)
    name = shipped_path(system, substeps, size).name
    out = folder / (name if seed == 0 else name.replace(".emulator", f"-seed-{seed}.emulator"))
    of_stride = out if strides == 1 else out.with_name(f"stride-of-{out.name}")
    config = recipe.training(stride, seed)
    emulator = train(read_transitions(data), config, of_stride, on_report=on_report)
    if strides > 1:
        emulator = emulator.in_strides(strides)
        save(emulator, out, read_metadata(of_stride)["provenance"])
    return emulator, out


def cook_soft(
    name: str,
    folder: Path,
    *,
    on_report: Callable[[Report], None] = lambda report: None,
) -> Path:
    """Return the file of the emulator that the recipe of a soft body makes in `folder`; a killed run is resumed.

    It is made from copies of the shipped TOML file and mesh, as users make emulators of their own bodies, and has error
    bounds.
    """
    assets = resources.files("neuroanimator.systems") / "assets"
    folder.mkdir(parents=True, exist_ok=True)
    toml = folder / f"{name}.toml"
    toml.write_bytes((assets / toml.name).read_bytes())
    mesh = tomllib.loads(toml.read_text(encoding="utf-8"))["mesh"]
    (folder / mesh).write_bytes((assets / mesh).read_bytes())
    trust_files(toml)
    _, definition, substeps = resolve(str(toml))
    recipe = SOFT_RECIPES[name]
    config = DatasetConfig.usual(name, definition, substeps, count=recipe.transitions)
    data = folder / emulator_name(name, substeps)
    generate(config, data)
    own = data.with_name(f"own-{data.name}.emulator.safetensors")
    told = {"unroll_share": recipe.unroll_share, "widths": recipe.widths}
    settings = {name: value for name, value in told.items() if value is not None}
    training = TrainingConfig.usual(
        load_system(str(toml)).structure, updates=recipe.updates, **settings
    )
    emulator = train(read_transitions(data), training, own, on_report=on_report)
    out = folder / shipped_path(name, substeps).name
    bounded = fit_error_bounds(
        emulator, random_runs=SOFT_RANDOM_RUNS, optimised_runs=SOFT_OPTIMISED_RUNS
    )
    packaged = replace(bounded, spec=replace(bounded.spec, definition=""))
    provenance = read_metadata(own)["provenance"]
    provenance["dataset"]["definition"] = ""
    save(packaged, out, provenance)
    return out
