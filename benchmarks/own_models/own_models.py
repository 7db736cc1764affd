"""Users' models: new, generate, train, evaluate, animate and control of ten, by proposed settings alone; own_models.csv.

python -m benchmarks.own_models.own_models             an hour and a half on two cores; needs Gymnasium, whose models it takes
python -m benchmarks.own_models.own_models hopper arm  some of the models; the others' lines stay
python -m benchmarks.own_models.own_models --quick     little data, few updates; writes no file
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from benchmarks.harness import keep_rows, parser_of, show_rows
from neuroanimator import (
    Emulator,
    Objective,
    SearchOptions,
    TrainingConfig,
    effort,
    make_clip,
    reach_state,
    synthesise,
    write_glb,
)
from neuroanimator.animation.gauges import drawable
from neuroanimator.learn.data.config import USUAL_COUNT, DatasetConfig
from neuroanimator.learn.data.generate import generate
from neuroanimator.learn.data.recorded_segments import limited_to_recordings
from neuroanimator.learn.data.store import read_transitions
from neuroanimator.learn.evaluation.evaluate import QUICK as QUICK_EVALUATION
from neuroanimator.learn.evaluation.evaluate import THOROUGH as THOROUGH_EVALUATION
from neuroanimator.learn.evaluation.evaluate import Evaluation, EvaluationBudget, evaluate
from neuroanimator.learn.training.train import train
from neuroanimator.physics import carried_system
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.slowness import slowness
from neuroanimator.systems.random_controls import sample_controls
from neuroanimator.systems.system import System

TABLE = Path(__file__).with_name("own_models.csv")

CASES = Path(__file__).parent
"""The models that are nobody else's."""

RECORDED_RUNS = 30
"""Number of runs in the recording."""

RECORDED_ROWS = 600
"""Number of rows in each of them, a hundredth of a second apart."""

NOISE = 0.01
"""Standard deviation of the recording's noise [rad]; that of its rate is five times as large."""

SECOND = 1.0
"""Rollouts are judged after this time [s], and tasks take so long; of slow systems what is to them as a second."""

TASK_SEED = 7
"""The controls that lead to a task's end are drawn from it."""

EFFORT_WEIGHT = 0.01
"""Effort in a task's objective, beside being there."""

SMALL = 1e-9
"""What never changes is measured by this."""


class Model(NamedTuple):
    """A model nobody here wrote for an emulator."""

    name: str
    put: Callable[[Path], str]
    """Puts its file into a folder if it needs one, and returns what `new` is to be told."""
    base: Literal["fixed", "free"] = "fixed"


@dataclass(frozen=True)
class Effort:
    """How much work the benchmark spends on a model."""

    count: int
    """The transitions asked for."""
    training: dict[str, Any]
    """What of the training is not as usual."""
    evaluation: EvaluationBudget


THOROUGH = Effort(USUAL_COUNT, {}, THOROUGH_EVALUATION)
"""The effort of the published table: the defaults of `generate`, `train` and `evaluate`."""

QUICK = Effort(12_000, {"updates": 2_000}, QUICK_EVALUATION)
"""The effort with --quick."""


def of_gymnasium(name: str) -> Callable[[Path], str]:
    """Return what names an environment of Gymnasium's, whose MJCF `new` copies by itself."""
    return lambda _: name


def of_case(name: str) -> Callable[[Path], str]:
    """Return what copies one of the cases into a folder."""

    def put(folder: Path) -> str:
        return str(shutil.copy(CASES / name, folder))

    return put


def recording(folder: Path) -> str:
    """Write a noisy recording of a driven pendulum whose angle is wrapped, and return its path."""
    rng = np.random.default_rng(0)
    lines = ["run,time s,state.angle rad,state.velocity rad/s,control.torque N·m"]
    for run in range(RECORDED_RUNS):
        angle = rng.uniform(-3, 3)
        velocity = 0.0
        torque = 0.0
        for row in range(RECORDED_ROWS):
            if row % 20 == 0:
                torque = rng.uniform(-2, 2)
            seen = (angle + NOISE * rng.normal() + np.pi) % (2 * np.pi) - np.pi
            seen_velocity = velocity + 5 * NOISE * rng.normal()
            lines.append(f"{run},{row * 0.01:.2f},{seen:.5f},{seen_velocity:.5f},{torque:.4f}")
            for _ in range(10):
                velocity += 0.001 * (3 * torque - 15 * np.sin(angle) - 0.3 * velocity)
                angle += 0.001 * velocity
    path = folder / "noisy.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(path)


MODELS = (
    Model("swimmer", of_gymnasium("Swimmer-v5")),
    Model("inverted_pendulum", of_gymnasium("InvertedPendulum-v5")),
    Model("hopper", of_gymnasium("Hopper-v5")),
    Model("walker2d", of_gymnasium("Walker2d-v5")),
    Model("ant", of_gymnasium("Ant-v5")),
    Model("humanoid", of_gymnasium("Humanoid-v5")),
    Model("arm", of_case("arm.urdf")),
    Model("walker", of_case("walker.urdf"), "free"),
    Model("gym_pendulum", of_case("gym_pendulum.py")),
    Model("recording", recording),
)
"""The ten models of the table."""


class Seconds(NamedTuple):
    """How long the steps of the way took [s]."""

    new: float
    data: float
    training: float
    evaluation: float
    animation: float
    control: float


def row_of(model: Model, effort: Effort, folder: Path) -> dict[str, Any]:
    """Return a model's line of the table, made in `folder` by what `new` proposes, without an edit."""
    clock = [time.perf_counter()]

    def done() -> None:
        clock.append(time.perf_counter())

    toml, proposal = write_definition(
        model.put(folder), folder / f"{model.name}.toml", base=model.base
    )
    done()
    trust_files(toml)
    name, definition, substeps = resolve(str(toml))
    config = limited_to_recordings(
        DatasetConfig.usual(name, definition, substeps, count=effort.count),
        carried_system(name, definition),
    )
    diverged = generate(config, folder / "data")
    data = read_transitions(folder / "data")
    done()
    out = folder / f"{model.name}.emulator.safetensors"
    settings = TrainingConfig.usual(data.system.structure, **effort.training)
    emulator = train(data, settings, out)
    done()
    evaluation = evaluate(emulator, data=data, budget=effort.evaluation)
    done()
    task = simple_task(emulator, data.system)
    clip = drawable(make_clip(emulator, task.states), emulator)
    write_glb(clip, folder / f"{model.name}.glb")
    done()
    left = way_left(emulator, data.system, task)
    done()
    seconds = Seconds(*np.diff(clock).tolist())
    row: dict[str, Any] = {"model": model.name, "warnings": len(proposal.warnings)}
    row |= {"n": substeps, "dt": emulator.dt, "runs_diverged": diverged}
    row |= _figures(evaluation)
    row |= {"way_left": left, "is_on_physics": data.system.can_simulate}
    row |= {f"{key}_s": value for key, value in seconds._asdict().items()}
    return row | {"whole_s": sum(seconds)}


class Task(NamedTuple):
    """To be, after a while, where random controls would have led from rest."""

    states: np.ndarray
    """(T+1, S) the motion under these controls, by the physics if there is any."""
    idle_states: np.ndarray
    """(T+1, S) the motion under what does nothing."""


def simple_task(emulator: Emulator, system: System) -> Task:
    """Return a task that can be done: its end state was reached by somebody who knew nothing."""
    rng = np.random.default_rng(TASK_SEED)
    steps = max(2, round(SECOND * slowness(emulator.dt) / emulator.dt))
    driven = sample_controls(rng, steps, emulator.dt, system.bounds, system.gait)
    idle = np.tile(system.bounds.idle, (steps, 1))
    if not system.can_simulate:
        return Task(*(np.asarray(emulator.rollout(system.rest, c)) for c in (driven, idle)))
    starts = np.tile(system.rest, (2, 1))
    runs = system.simulate(starts, np.stack([driven, idle]), emulator.dt)
    return Task(runs.states[0], runs.states[1])


def way_left(emulator: Emulator, system: System, task: Task) -> float:
    """Return how far from the task's end the motion of the controller ends, over how far doing nothing does.

    Counted is what the task asks for: positions and orientations, or all of a state that has no rates; each in units of
    how much it changes in a super step. The motion is the physics', unless there is none.
    """
    target = task.states[-1]
    rates = {rate for _, rate in [*system.structure.rates, *system.structure.orientations]}
    wanted = {}
    entries: list[int] = []
    for part in system.state.slices:
        where = system.state.index(part.name)
        if where.start not in rates:
            wanted[part.name] = target[where].tolist()
            entries += range(where.start, where.stop)
    objective = Objective.of(effort(EFFORT_WEIGHT), reach_state(system, wanted))
    steps = len(task.states) - 1
    options = SearchOptions(refinements=0)
    found = synthesise(emulator, system, objective, system.rest, steps=steps, options=options)
    frame = Frame.of(system.structure, 0.0)
    of_entries = frame.change_entries(system.state.size)
    counted = sorted({number for entry in entries for number in of_entries[entry]})
    unit = np.maximum(np.asarray(emulator.normaliser.unit), SMALL)

    def distance(end: np.ndarray) -> float:
        difference = frame.difference(target, end) / unit
        return float(np.linalg.norm(difference[counted]))

    return distance(found.outcome.physics_states[-1]) / distance(task.idle_states[-1])


def _figures(evaluation: Evaluation) -> dict[str, Any]:
    """Return accuracy and speed: an error only beside what the physics differs from itself by."""
    figures = evaluation.row()
    chosen: dict[str, Any] = {
        "one_step_error": evaluation.one_step_error,
        "noise_error": figures["noise_error"],
        "error_after_1s": evaluation.rollout_error_at(SECOND),
        "self_divergence_after_1s": _self_divergence_at(evaluation, SECOND),
    }
    for key in ("nominal_speedup", "equal_error_speedup", "equal_error_baseline", "verdict"):
        chosen[key] = figures[key]
    return chosen


def _self_divergence_at(evaluation: Evaluation, seconds: float) -> float | str:
    """Return how far the physics at its own step is off fine physics after `seconds`; "none" of recordings."""
    if evaluation.self_divergence is None:
        return "none"
    step = min(round(seconds / evaluation.dt), len(evaluation.self_divergence) - 1)
    return float(evaluation.self_divergence[step])


def main() -> None:
    parser = parser_of(__doc__, quick="little data")
    parser.add_argument("models", nargs="*", help="the models to try; all if none is named")
    arguments = parser.parse_args()
    effort = QUICK if arguments.quick else THOROUGH
    names = [model.name for model in MODELS]
    rows = []
    for model in MODELS:
        if arguments.models and model.name not in arguments.models:
            continue
        with tempfile.TemporaryDirectory() as name:
            rows.append(row_of(model, effort, Path(name)))
        show_rows(rows[-1:])
        keep_rows(TABLE, rows, arguments, "model", order=lambda row: names.index(row["model"]))
    show_rows(rows)


if __name__ == "__main__":
    main()
