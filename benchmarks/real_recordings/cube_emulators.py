"""Rows of the table that need an emulator of a cube: of the fitted physics, or of the recording alone.

    our model of the cube, fitted to the training tosses → dataset → emulator → (c)
      ⤷ fine-tune on the training tosses → (d)
    the training tosses alone → (e) an emulator that knows nothing else

Random starts of the dataset are those of tosses. The emulator sees contacts coming: it is shown the heights of the corners.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp

import mujoco
import numpy as np
import tomlkit

from benchmarks.harness import Clocks
from benchmarks.real_recordings.bounds import bounded_shares
from benchmarks.real_recordings.cases import MODELS, Case
from benchmarks.real_recordings.families import CUBE_SAMPLES, by_emulator
from benchmarks.real_recordings.fitted_physics import fit_physics
from benchmarks.real_recordings.methods import Prediction, making_cells
from benchmarks.real_recordings.runs import Run, write_recording
from neuroanimator import DatasetConfig, Emulator, TrainingConfig, fine_tune, train
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.evaluation.weakness.config import ImprovementConfig
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.scaffold.write_toml import write_definition

TRANSITIONS = 600_000

TRAINING = {"widths": (256, 192), "batch": 1024, "updates": 16_000}

TUNING = {"updates": 3_000}

HELD_OUT = 120
"""Number of training tosses that nothing is fine-tuned on: error bounds are measured on them."""

SAMPLING = {
    "rest_share": 0.05,
    "reset_share": 0.0,
    "warm_up": 0.0,
    "height": [-0.02, 0.15],
    "tilt": 2.0,
}
"""Random starts: tosses, with a few near rest."""

VELOCITIES = [0.7, 0.7, 0.7, 3.0, 3.0, 3.0]
"""Standard deviations of their velocities [m/s, rad/s], 1.2 times those of the tosses."""


@dataclass(frozen=True)
class Cube:
    """The emulator of the fitted physics."""

    toml: Path
    emulator: Emulator
    making: Clocks
    """Times of fit, dataset and training."""


def cube_emulator(case: Case, training: list[Run]) -> Prediction | None:
    """Return the emulator of the fitted physics; None of a pendulum."""
    if not case.is_cube:
        return None
    cube = _cube(case, tuple(training))
    shares = bounded_shares(case, cube.emulator, 0.0, training)
    figures = making_cells(cube.making)
    return Prediction(by_emulator(case, cube.emulator), figures, shares)


def cube_fine_tuned(case: Case, training: list[Run]) -> Prediction | None:
    """Return that emulator after it has learnt from the training tosses as well; None of a pendulum."""
    if not case.is_cube:
        return None
    cube = _cube(case, tuple(training))
    trust_files(cube.toml)
    learnt = training[:-HELD_OUT]
    recording = cube.toml.parent / "training.csv"
    write_recording(recording, learnt, case.columns, case.dt)
    out = cube.toml.parent / "tuned.emulator.safetensors"
    began = Clocks.now()
    tuned = fine_tune(cube.emulator, recording, out, config=ImprovementConfig(**TUNING)).emulator
    figures = making_cells(cube.making.plus(began.passed()))
    shares = bounded_shares(case, tuned, 0.0, training[-HELD_OUT:])
    return Prediction(by_emulator(case, tuned), figures, shares)


_KEPT: dict[str, Cube] = {}


def _cube(case: Case, training: tuple[Run, ...]) -> Cube:
    """Return the emulator of a case's fitted physics, made once in a process."""
    if case.name not in _KEPT:
        _KEPT[case.name] = _make_cube(case, list(training))
    return _KEPT[case.name]


def _make_cube(case: Case, training: list[Run]) -> Cube:
    began = Clocks.now()
    model = fit_physics(case, training).model
    toml = write_cube(case, model, Path(mkdtemp()))
    trust_files(toml)
    name, definition, substeps = resolve(str(toml))
    config = DatasetConfig.usual(name, definition, substeps, count=TRANSITIONS)
    data = simulate_transitions(config)
    settings = TrainingConfig.usual(data.system.structure, **TRAINING)
    emulator = train(data, settings, toml.parent / "cube.emulator.safetensors")
    return Cube(toml, emulator, began.passed())


def write_cube(case: Case, model: mujoco.MjModel, folder: Path) -> Path:
    """Write a fitted model and its TOML file, with the starts of tosses; return this one's path."""
    path = folder / case.own_model_file
    write_model(case, model, path)
    toml, _ = write_definition(str(path))
    document = tomlkit.parse(toml.read_text(encoding="utf-8"))
    document["substeps"] = round(CUBE_SAMPLES * case.dt / model.opt.timestep)
    document["sampling"].update(SAMPLING)
    document["sampling"]["velocity"]["cube"] = VELOCITIES
    toml.write_text(tomlkit.dumps(document), encoding="utf-8")
    return toml


def write_model(case: Case, model: mujoco.MjModel, path: Path) -> None:
    """Write our model of the cube with the numbers of a fitted one."""
    tree = ElementTree.parse(MODELS / case.own_model_file)
    _put(tree, "option", gravity=model.opt.gravity)
    _put(tree, "inertial", pos=model.body_ipos[1], diaginertia=model.body_inertia[1])
    board = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "board")
    _put(tree, "geom[@name='board']", pos=model.geom_pos[board])
    corners = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
    first = corners[0]
    _put(
        tree,
        "default[@class='corner']/geom",
        size=model.geom_size[first, :1],
        friction=model.geom_friction[first],
        solref=model.geom_solref[first],
    )
    for geom, corner in zip(tree.iterfind(".//geom[@class='corner']"), corners, strict=True):
        geom.set("pos", _text(model.geom_pos[corner]))
    tree.write(path)


def _put(tree: ElementTree.ElementTree, place: str, **attributes: np.ndarray) -> None:
    """Set attributes of the one element at `place`."""
    [element] = tree.iterfind(f".//{place}")
    for name, values in attributes.items():
        element.set(name, _text(values))


def _text(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)
