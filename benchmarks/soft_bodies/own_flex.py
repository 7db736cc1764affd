"""Somebody's own flexes of MuJoCo, a cloth and a jelly, from `new` to an emulator by what is proposed; error and time."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import neuroanimator as na
from benchmarks.soft_bodies.equal_error import EMULATOR, Race, add_emulator, unseen
from neuroanimator.learn.data.config import SAMPLES_PER_RUN, DatasetConfig
from neuroanimator.learn.training.config import TrainingConfig
from neuroanimator.learn.training.train import METRICS, read_metrics, run_folder
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.physics.soft.scene import Motion
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.scaffold.write_toml import write_definition

MODELS = Path(__file__).parent / "models"
"""The models that are nobody else's: a cloth tied to a bar, and a jelly on the ground that a paddle strikes."""

COARSER = (1, 2, 4)
"""Steps over the model's own, beside the teacher's."""


class Extent(NamedTuple):
    """How much is done for each model."""

    count: int
    """Transitions."""
    updates: int


EXTENTS = {
    "cloth": Extent(count=6_144, updates=4_000),
    "jelly": Extent(count=3_072, updates=2_000),
}
"""By model: half and a quarter of what `generate` and `train` do if nothing is said."""

QUICK = Extent(count=240, updates=500)


def own_flex_rows(name: str, folder: Path, extent: Extent) -> list[dict[str, Any]]:
    """Return a row for the emulator of a model and for each physics beside it, all timed in turn.

    Data and training lie in `folder`, and go on where they stopped.
    """
    toml, emulator = made(name, folder, extent)
    system = na.load_system(str(toml))
    assert isinstance(system, SoftSystem)
    test = unseen(system, emulator.dt)
    race = Race(test, emulator)
    add_emulator(race)
    own_steps = system.scheme.steps(emulator.dt)
    start = Motion(*(np.ascontiguousarray(part[..., 0]) for part in test.start[:2]))
    path = test.paths[..., 0]
    for steps in (system.truth.steps(emulator.dt), *(own_steps // share for share in COARSER)):
        nodes, _ = system.scene.play(test.start, test.paths, emulator.dt, steps)
        what = called(steps)
        if not np.isfinite(nodes).all():
            race.rows.append({"what": f"{what}: diverges"})
            continue
        race.add(
            what, nodes, lambda steps=steps: system.scene.play(start, path, emulator.dt, steps)
        )
    return told(name, race.timed(), system, emulator, folder, extent)


def called(steps: int) -> str:
    """Return the name of the physics in so many steps a super step."""
    return f"flex, {steps} small steps"


def made(name: str, folder: Path, extent: Extent) -> tuple[Path, na.Emulator]:
    """Return the definition that `new` writes for a model, and the emulator that is trained by it."""
    folder.mkdir(parents=True, exist_ok=True)
    toml = folder / f"{name}.toml"
    if not toml.exists():
        shutil.copy(MODELS / f"{name}.xml", folder)
        write_definition(str(folder / f"{name}.xml"), toml)
    return toml, learnt(toml, extent)


def learnt(toml: Path, extent: Extent) -> na.Emulator:
    """Return the emulator that is trained by a definition, beside which all its files lie."""
    trust_files(toml)
    system, definition, substeps = resolve(str(toml))
    data = toml.with_suffix(".data")
    na.generate(DatasetConfig.usual(system, definition, substeps, count=extent.count), data)
    transitions = na.read_transitions(data)
    settings = TrainingConfig.usual(transitions.system.structure, updates=extent.updates)
    return na.train(transitions, settings, out_of(toml.stem, toml.parent))


def out_of(name: str, folder: Path) -> Path:
    """Return where the emulator of a model lies."""
    return folder / f"{name}.emulator.safetensors"


def told(
    name: str,
    rows: list[dict[str, Any]],
    system: SoftSystem,
    emulator: na.Emulator,
    folder: Path,
    extent: Extent,
) -> list[dict[str, Any]]:
    """Return the rows with the model, times over the emulator's, and what the emulator took."""
    own = {row["what"]: row for row in rows}
    latent = own[EMULATOR]["us_a_super_step"]
    teacher = own[called(system.truth.steps(emulator.dt))]
    super_steps = extent.count // SAMPLES_PER_RUN * system.run_steps
    reports = read_metrics(run_folder(out_of(name, folder)) / METRICS)
    found = []
    for row in rows:
        seconds = row.get("us_a_super_step")
        line: dict[str, Any] = {"body": name, "nodes": len(system.scene.body.positions)}
        for column in own[EMULATOR]:
            line[column] = row.get(column, "")
        line["times_emulator"] = seconds / latent if seconds else ""
        line["data_minutes_of_a_core"] = ""
        line["training_minutes"] = ""
        if row["what"] == EMULATOR:
            line["data_minutes_of_a_core"] = super_steps * teacher["us_a_super_step"] / 6e7
            line["training_minutes"] = reports[-1].seconds / 60
        found.append(line)
    return found
