"""Anybody's model: new, generate, train and evaluate on ten models, by what is proposed alone; writes results/own_models.csv.

python benchmarks/own_models.py                     about an hour on two cores; needs Gymnasium, whose models it takes
python benchmarks/own_models.py --quick             little data, few updates; writes no file
python benchmarks/own_models.py --quick hopper arm  some of the models
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from neuroanimator import TrainingConfig
from neuroanimator.bench.csv_table import describe_machine, write_csv
from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import generate
from neuroanimator.data.recorded_segments import limited_to_recordings
from neuroanimator.data.store import read_transitions
from neuroanimator.evaluation.evaluate import QUICK as QUICK_EVALUATION
from neuroanimator.evaluation.evaluate import THOROUGH as THOROUGH_EVALUATION
from neuroanimator.evaluation.evaluate import Evaluation, EvaluationBudget, evaluate
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.loading import resolve, trust_files
from neuroanimator.terminal import print_table
from neuroanimator.training.train import train

CASES = Path(__file__).parent / "own_models_cases"
"""The models that are nobody else's."""

RECORDED_RUNS = 30
"""The recording has so many runs."""

RECORDED_ROWS = 600
"""Each of them has so many rows, a hundredth of a second apart."""

NOISE = 0.01
"""Standard deviation of the recording's noise [rad]; that of its rate is five times as large."""

SECOND = 1.0
"""Rollouts are judged after this time [s]."""


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
    updates: int
    """The updates of a training run."""
    evaluation: EvaluationBudget


THOROUGH = Effort(100_000, TrainingConfig().updates, THOROUGH_EVALUATION)
"""The effort of the published table: the defaults of `generate`, `train` and `evaluate`."""

QUICK = Effort(12_000, 2_000, QUICK_EVALUATION)
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


def row_of(model: Model, effort: Effort, folder: Path) -> dict[str, Any]:
    """Return a model's line of the table, made in `folder` by what `new` proposes, without an edit."""
    clock = [time.perf_counter()]
    toml, proposal = write_definition(
        model.put(folder), folder / f"{model.name}.toml", base=model.base
    )
    clock.append(time.perf_counter())
    trust_files(toml)
    name, definition, substeps = resolve(str(toml))
    config = limited_to_recordings(
        DatasetConfig(system=name, definition=definition, substeps=substeps, count=effort.count)
    )
    diverged = generate(config, folder / "data")
    data = read_transitions(folder / "data")
    clock.append(time.perf_counter())
    out = folder / f"{model.name}.emulator.safetensors"
    emulator = train(data, TrainingConfig(updates=effort.updates), out)
    clock.append(time.perf_counter())
    evaluation = evaluate(emulator, data=data, budget=effort.evaluation)
    clock.append(time.perf_counter())
    seconds = Seconds(*np.diff(clock).tolist())
    row: dict[str, Any] = {"model": model.name, "warnings": len(proposal.warnings)}
    row |= {"n": substeps, "dt": emulator.dt, "runs_diverged": diverged}
    return (
        row | _figures(evaluation) | {f"{key}_s": value for key, value in seconds._asdict().items()}
    )


def _figures(evaluation: Evaluation) -> dict[str, Any]:
    """Return accuracy and speed: an error only beside what the physics differs from itself by."""
    figures = evaluation.row()
    chosen: dict[str, Any] = {
        "one_step_error": evaluation.one_step_error,
        "noise_error": figures["noise_error"],
        "error_after_1s": evaluation.rollout_error_at(SECOND),
        "self_divergence_after_1s": _self_divergence_at(evaluation, SECOND),
    }
    for key in ("nominal_speedup", "equal_error_speedup", "equal_error_rival", "verdict"):
        chosen[key] = figures[key]
    return chosen


def _self_divergence_at(evaluation: Evaluation, seconds: float) -> float | str:
    """Return how far the physics at its own step is off fine physics after `seconds`; "none" of recordings."""
    if evaluation.self_divergence is None:
        return "none"
    step = min(round(seconds / evaluation.dt), len(evaluation.self_divergence) - 1)
    return float(evaluation.self_divergence[step])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="little data; writes no file")
    parser.add_argument("models", nargs="*", help="the models to try; all if none is named")
    arguments = parser.parse_args()
    effort = QUICK if arguments.quick else THOROUGH
    rows = []
    for model in MODELS:
        if arguments.models and model.name not in arguments.models:
            continue
        with tempfile.TemporaryDirectory() as name:
            rows.append(row_of(model, effort, Path(name)))
        print_table(rows[-1:])
    if not arguments.quick and not arguments.models:
        write_csv(Path(__file__).parent / "results" / "own_models.csv", rows)
    print(describe_machine())
    print_table(rows)


if __name__ == "__main__":
    main()
