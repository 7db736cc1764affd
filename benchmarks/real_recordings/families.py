"""Rows of the table that need an emulator: of a family around the authors' model, or of the recording alone.

    the authors' model + ranges → dataset → emulator of the family
      ⤷ identify from the training part → (b) the physics with these parameters, (c) the emulator with them
          ⤷ fine-tune on the training part → (d)
    the training part alone → (e) an emulator that knows nothing else

Starts of the dataset are as far from rest as the training part goes, so that the emulator knows what this body does. What was
measured are angles; their velocities are made of them, so identification is not shown them.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import tomlkit
from jaxtyping import Float

from benchmarks.harness import Clocks
from benchmarks.real_recordings.bounds import bounded_shares, super_steps
from benchmarks.real_recordings.cases import MODELS, Case, Windows
from benchmarks.real_recordings.methods import Method, Predict, Prediction, making_cells
from benchmarks.real_recordings.runs import Columns, Run, write_recording
from neuroanimator import (
    DatasetConfig,
    Emulator,
    Identification,
    TrainingConfig,
    fine_tune,
    identify,
    load_system,
    train,
)
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.evaluation.weakness.fine_tune import TAIL
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.scaffold.write_toml import write_definition

SUPER_STEP = 0.05
"""Super step of the emulators [s]: every horizon of the table is a multiple."""

CUBE_SAMPLES = 4
"""Number of samples in a super step of a cube: 27 ms."""

TRANSITIONS = 200_000

UPDATES = 25_000

WIDTHS = (128, 96)

ROOM = 1.2
"""Starts of the dataset go further than the training part by this factor."""

MASS = (0.7, 1.3)
CENTRE = (0.8, 1.2)
INERTIA = (0.3, 3.0)
"""Ranges of a link's mass, the height of its centre of mass and its moments of inertia, over the authors' values."""

DAMPING = 4.0
"""Largest viscous damping of a hinge, over the larger of the authors' and `LITTLE_DAMPING`."""

LITTLE_DAMPING = 1e-3
"""[N·m·s/rad]"""

COULOMB = 3.0
"""Largest Coulomb friction of a hinge, over the larger of the authors' and `LITTLE_COULOMB`."""

LITTLE_COULOMB = 2e-3
"""[N·m]"""

GAIN = (0.7, 1.3)
"""Range of a motor's gain."""


@dataclass(frozen=True)
class Family:
    """A family's emulator and what the training part says of this body."""

    toml: Path
    emulator: Emulator
    identification: Identification
    recording: Path
    """The training part, all of its state."""
    making: Clocks
    """Times of dataset, training and identification."""


def of_chains(method: Callable[[Case, list[Run]], Prediction]) -> Method:
    """Return the method for chains of hinges; see `cube_emulators` for the cube."""

    def of_chain(case: Case, training: list[Run]) -> Prediction | None:
        return None if case.is_cube else method(case, training)

    return of_chain


def identified_physics(case: Case, training: list[Run]) -> Prediction:
    """Return the physics with the parameters that `identify` finds through the emulator of the family."""
    family = _family(case, tuple(training))
    body = load_system(str(family.toml)).at(**_inside(family))
    offsets = _offsets(family)

    def predict(
        starts: Float[np.ndarray, "W S"], controls: Float[np.ndarray, "W T C"]
    ) -> Float[np.ndarray, "W T+1 S"]:
        whole = np.tile(body.rest, (len(starts), 1))
        whole[:, : starts.shape[1]] = starts - offsets
        held = np.zeros((*controls.shape[:2], body.control.size))
        held[..., : controls.shape[2]] = controls
        runs = body.simulate(whole, body.bounds.clip(held), case.dt)
        return runs.states[..., : starts.shape[1]] + offsets

    return Prediction(predict, _figures(family))


def identified_emulator(case: Case, training: list[Run]) -> Prediction:
    """Return the emulator of the family at these parameters."""
    family = _family(case, tuple(training))
    mine = family.emulator.at(**_inside(family))
    offsets = _offsets(family)
    shares = bounded_shares(case, mine, offsets, training)
    return Prediction(by_emulator(case, mine, offsets), _figures(family), shares)


def fine_tuned_emulator(case: Case, training: list[Run]) -> Prediction:
    """Return that emulator after it has learnt from the training part as well."""
    family = _family(case, tuple(training))
    trust_files(family.toml)
    mine = family.emulator.at(**_inside(family))
    out = family.toml.parent / "tuned.emulator.safetensors"
    tuned = fine_tune(mine, family.recording, out).emulator
    shares = bounded_shares(case, tuned, 0.0, _tails(training))
    return Prediction(by_emulator(case, tuned), _figures(family), shares)


def _tails(training: list[Run]) -> list[Run]:
    """Return the ends of runs that `fine_tune` keeps for its test."""
    tails = []
    for run in training:
        cut = len(run.states) - round(TAIL * len(run.states))
        tails.append(Run(run.name, run.states[cut:], run.controls[cut:]))
    return tails


def recording_alone(case: Case, training: list[Run]) -> Prediction:
    """Return an emulator that is trained on the training part and knows nothing else."""
    folder = Path(mkdtemp())
    path = folder / "alone.csv"
    write_recording(path, training, case.columns, case.dt)
    toml, _ = write_definition(str(path))
    trust_files(toml)
    name, definition, _ = resolve(str(toml))
    substeps = CUBE_SAMPLES if case.is_cube else round(SUPER_STEP / case.dt)
    rows = sum(len(run.states) for run in training)
    config = DatasetConfig(system=name, definition=definition, substeps=substeps, count=rows)
    data = simulate_transitions(config)
    emulator = train(data, TrainingConfig(updates=UPDATES // 4), folder / "alone.safetensors")
    return Prediction(by_emulator(case, emulator))


def by_emulator(
    case: Case, emulator: Emulator, offsets: Float[np.ndarray, " S"] | float = 0.0
) -> Predict:
    """Return what predicts by super steps, of sensors with these `offsets`; between steps states lie on straight lines."""
    samples = round(emulator.dt / case.dt)

    def predict(
        starts: Float[np.ndarray, "W S"], controls: Float[np.ndarray, "W T C"]
    ) -> Float[np.ndarray, "W T+1 S"]:
        count = controls.shape[1]
        rest = -count % samples  # to the end of the last super step
        held = np.pad(controls, ((0, 0), (0, rest), (0, 0)), mode="edge")
        runs = super_steps(case, emulator, offsets, Windows(starts[:, None], held, None))
        motion = emulator.rollout(runs.states[:, 0], runs.controls, may_diverge=True)
        states = np.asarray(motion, float)[..., : starts.shape[1]] + offsets
        share = np.arange(samples)[:, None] / samples
        between = states[:, :-1, None] + share * np.diff(states, axis=1)[:, :, None]
        flat = between.reshape(len(starts), -1, states.shape[2])
        whole = np.concatenate([flat, states[:, -1:]], axis=1)
        return whole[:, : count + 1]

    return predict


_KEPT: dict[str, Family] = {}


def _family(case: Case, training: tuple[Run, ...]) -> Family:
    """Return the family around a case's model, made once in a process."""
    if case.name not in _KEPT:
        _KEPT[case.name] = _make_family(case, list(training))
    return _KEPT[case.name]


def _make_family(case: Case, training: list[Run]) -> Family:
    folder = Path(mkdtemp())
    toml = write_family(case, training, folder)
    recording = folder / "training.csv"
    write_recording(recording, training, case.columns, case.dt)
    angles = folder / "angles.csv"
    hinges = training[0].states.shape[1] // 2
    measured = [replace(run, states=run.states[:, :hinges]) for run in training]
    shown = Columns(case.columns.state[:hinges], case.columns.control)
    write_recording(angles, measured, shown, case.dt)
    trust_files(toml)
    name, definition, substeps = resolve(str(toml))
    began = Clocks.now()
    config = DatasetConfig(system=name, definition=definition, substeps=substeps, count=TRANSITIONS)
    data = simulate_transitions(config)
    settings = TrainingConfig(updates=UPDATES, widths=WIDTHS)
    emulator = train(data, settings, folder / "family.emulator.safetensors")
    found = identify(emulator, angles, offsets=True)
    return Family(toml, emulator, found, recording, began.passed())


def write_family(case: Case, training: list[Run], folder: Path) -> Path:
    """Write the TOML file of the family around a case's model; return its path."""
    model = folder / case.model_file
    shutil.copy(MODELS / case.model_file, model)
    path, _ = write_definition(str(model))
    document = tomlkit.parse(path.read_text(encoding="utf-8"))
    document["substeps"] = round(SUPER_STEP / float(document["physics"]["step"]))
    states = np.concatenate([run.states for run in training])
    hinges = states.shape[1] // 2
    sampling = document["sampling"]
    for hinge in range(hinges):
        name = f"hinge{hinge + 1}"
        sampling["position"][name] = float(ROOM * np.abs(states[:, hinge]).max())
        sampling["velocity"][name] = [float(ROOM * states[:, hinges + hinge].std())]
    sampling["warm_up"] = 0.0
    document["parameters"] = _parameters(case)
    path.write_text(tomlkit.dumps(document), encoding="utf-8")
    return path


def _parameters(case: Case) -> dict[str, dict[str, object]]:
    """Return the table of parameters: each link and hinge, and the motors' gain.

    Where nothing drives the body, only ratios of masses show: the first one is fixed.
    """
    model = case.model()
    has_motors = bool(case.columns.control)
    tables: dict[str, dict[str, object]] = {}
    for hinge in range(model.njnt):
        number = hinge + 1
        link = f"body/link{number}"
        joint = f"joint/hinge{number}"
        body = int(model.jnt_bodyid[hinge])
        if has_motors or hinge > 0:
            tables[f"mass{number}"] = _shares(f"{link}/mass", model.body_mass[body], MASS)
        centre = model.body_ipos[body, 2]
        tables[f"centre{number}"] = _shares(f"{link}/ipos[2]", centre, CENTRE)
        tables[f"inertia{number}"] = _shares(f"{link}/inertia_factor", 1.0, INERTIA)
        damping = DAMPING * max(float(model.dof_damping[hinge]), LITTLE_DAMPING)
        tables[f"damping{number}"] = {"sets": f"{joint}/damping", "range": [0.0, damping]}
        coulomb = COULOMB * max(float(model.dof_frictionloss[hinge]), LITTLE_COULOMB)
        tables[f"coulomb{number}"] = {"sets": f"{joint}/frictionloss", "range": [0.0, coulomb]}
        if has_motors:
            tables[f"gain{number}"] = _shares(f"actuator/torque{number}/gear", 1.0, GAIN)
    return tables


def _shares(sets: str, value: float, shares: tuple[float, float]) -> dict[str, object]:
    ends = sorted(float(value) * share for share in shares)
    return {"sets": sets, "range": ends}


def _offsets(family: Family) -> Float[np.ndarray, " S"]:
    """Return by how much each sensor is off: those of angles as identified, none of velocities."""
    hinges = len(family.identification.measurements.entries)
    offsets = np.zeros(2 * hinges)
    offsets[:hinges] = [
        estimate.value
        for estimate in family.identification.estimates
        if estimate.name.startswith("offset")
    ]
    return offsets


def _inside(family: Family) -> dict[str, float]:
    """Return the identified parameters, at the very ends of ranges rounded inwards."""
    bounds = {parameter.name: parameter for parameter in family.emulator.parameters}
    return {
        name: float(np.clip(value, bounds[name].low, bounds[name].high))
        for name, value in family.identification.parameters.items()
    }


def _figures(family: Family) -> dict[str, object]:
    found = family.identification
    fitted = " ".join(f"{estimate.name}={estimate.value:.4g}" for estimate in found.estimates)
    counts = {"iterations": found.final.iterations, "fitted": fitted}
    return making_cells(family.making) | counts
