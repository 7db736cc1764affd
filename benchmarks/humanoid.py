"""Does a network a limb pay? MuJoCo's humanoid, floating freely; writes results/humanoid.csv.

python benchmarks/humanoid.py          ten minutes on two cores; needs Gymnasium, whose model it takes
python benchmarks/humanoid.py --quick  a minute or two: little data, few updates; writes no file
"""

from __future__ import annotations

import argparse
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from neuroanimator import TrainingConfig
from neuroanimator.bench.csv_table import describe_machine, write_csv
from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.accuracy import one_step_error, root_mean_square
from neuroanimator.evaluation.baselines import baselines
from neuroanimator.evaluation.held_out import HeldOut, held_out_runs
from neuroanimator.evaluation.speed import (
    PHYSICS_STEPS,
    TIMED_SUPER_STEPS,
    emulator_player,
    interleaved,
    one_core,
    physics_player,
)
from neuroanimator.gym import mjcf_of
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.loading import resolve
from neuroanimator.systems.rigid.mujoco_system import MujocoSystem
from neuroanimator.terminal import print_table
from neuroanimator.training.train import train

SUBSTEPS = 25
"""Of 3 ms each, the model's own step."""

GROUPS = """
[groups]
torso = ["abdomen_z", "abdomen_y", "abdomen_x"]
right_leg = ["right_hip_x", "right_hip_z", "right_hip_y", "right_knee"]
left_leg = ["left_hip_x", "left_hip_z", "left_hip_y", "left_knee"]
right_arm = ["right_shoulder1", "right_shoulder2", "right_elbow"]
left_arm = ["left_shoulder1", "left_shoulder2", "left_elbow"]
"""

NETWORKS: dict[str, tuple[tuple[int, ...], ...]] = {
    "glu": ((96, 64),),
    "linear-glu": ((64, 48), (96, 64), (160, 96), (224, 128)),
    "hierarchy": ((64, 0, 24), (64, 48, 0, 24), (64, 48, 0, 48), (96, 64, 0, 64)),
}
"""Per kind the widths tried: networks that cost 2 to 4 µs a super step."""

CLEAR = 0.03
"""Share by which errors must differ to call one better: chosen, as one seed cannot show its own spread."""

REPEATS = 25
"""Timings of each side: enough to outlast a burst of other work on a shared machine."""


@dataclass(frozen=True)
class Effort:
    """How much work the benchmark spends."""

    windows: int
    updates: int
    runs: int
    repeats: int
    widths: int
    """Of each kind, at most."""


THOROUGH, QUICK = Effort(108_000, 6_000, 32, REPEATS, widths=4), Effort(3_600, 500, 4, 3, widths=1)


class Measured(NamedTuple):
    """One trained network."""

    kind: str
    emulator: Emulator
    errors: np.ndarray
    """(V,) one-step error of each number of the change, over its standard deviation."""
    cost: float
    """Of one super step [µs]."""

    @property
    def family(self) -> str:
        """`flat` or `hierarchy`."""
        return self.kind if self.kind == "hierarchy" else "flat"

    @property
    def error(self) -> float:
        return float(root_mean_square(self.errors))


def floating_humanoid(folder: Path) -> Path:
    """Write Gymnasium's humanoid without floor, contacts and gravity, and return its TOML file with `GROUPS`."""
    text = mjcf_of("Humanoid-v5").read_text()
    text, floors = re.subn(r'<geom [^>]*name="floor"[^>]*/>', "", text)
    text, contacts = re.subn(
        r'conaffinity="1" condim="1" contype="1"', 'contype="0" conaffinity="0"', text
    )
    text, options = re.subn("<option ", '<option gravity="0 0 0" ', text)
    assert (floors, contacts, options) == (2, 1, 1), (
        "Gymnasium's humanoid.xml is another than this was written for."
    )
    (folder / "humanoid.xml").write_text(text)
    path, _ = write_definition(str(folder / "humanoid.xml"))
    # Taught by the model's own step: its error is a hundredth of the networks', and finer steps would take long.
    found = re.sub(r"(?m)^truth_step = \S+", "truth_step = 0.003", path.read_text())
    path.write_text(found + GROUPS)
    return path


def measure(
    data: Transitions, effort: Effort, folder: Path
) -> tuple[list[Measured], HeldOut, float]:
    """Return the trained networks, the test, and the cost of the physics per super step [µs]."""
    emulators = [
        (kind, trained(data, kind, widths, effort.updates, folder))
        for kind, every in NETWORKS.items()
        for widths in every[: effort.widths]
    ]
    test = held_out_runs(emulators[0][1], effort.runs, seconds=3.0)
    assert isinstance(test.system, MujocoSystem)
    players = {str(i): emulator_player(emulator) for i, (_, emulator) in enumerate(emulators)}
    players["physics"] = physics_player(test.system, test, test.system.scheme.integrator)
    with one_core():
        spans = interleaved(players, effort.repeats)
    measured = [
        Measured(
            kind, emulator, one_step_error(emulator, test), spans[str(i)] / TIMED_SUPER_STEPS * 1e6
        )
        for i, (kind, emulator) in enumerate(emulators)
    ]
    return measured, test, spans["physics"] / PHYSICS_STEPS * SUBSTEPS * 1e6


def trained(
    data: Transitions, kind: Any, widths: tuple[int, ...], updates: int, folder: Path
) -> Emulator:
    """Return the best of a training run of single super steps."""
    config = TrainingConfig(network=kind, widths=widths, updates=updates, unroll=1)
    return train(data, config, folder / f"{kind}-{'-'.join(map(str, widths))}.safetensors")


def row(one: Measured, every: list[Measured], physics: float) -> dict[str, Any]:
    """Return a line of the table."""
    names = one.emulator.state.names
    root = [*range(6), *range(len(names) - len(names) // 2, len(names) - len(names) // 2 + 6)]
    rivals = [other for other in every if other.family != one.family]
    error = rival_error(one.cost, rivals)
    return {
        "network": one.kind,
        "widths": " ".join(map(str, one.emulator.network.widths)),
        "weights": sum(
            leaf.size
            for leaf in jax.tree.leaves(one.emulator.network)
            if isinstance(leaf, jax.Array)
        ),
        "error": one.error,
        "root_error": float(root_mean_square(one.errors[root])),
        "limb_error": float(root_mean_square(np.delete(one.errors, root))),
        "us": one.cost,
        "physics_over_it": physics / one.cost,
        "rival_error_at_its_cost": error or "",
        "rival_us_at_its_error": rival_cost(one.error, rivals) or "",
        "better_at_equal_cost": better(one, rivals, error),
    }


def frontier(networks: list[Measured]) -> tuple[np.ndarray, np.ndarray]:
    """Return logarithms of (costs, errors) of the networks no cheaper one of which is as exact, cheapest first."""
    kept: list[Measured] = []
    for one in sorted(networks, key=lambda one: one.cost):
        if not kept or one.error < kept[-1].error:
            kept.append(one)
    return np.log([one.cost for one in kept]), np.log([one.error for one in kept])


def rival_error(cost: float, rivals: list[Measured]) -> float | None:
    """Return the error rivals have at that cost or less, between their widths by powers; None if none is as cheap."""
    costs, errors = frontier(rivals)
    if np.log(cost) < costs[0]:
        return None
    return float(np.exp(np.interp(np.log(cost), costs, errors)))


def rival_cost(error: float, rivals: list[Measured]) -> float | None:
    """Return the cost at which rivals have that error; None if none is as exact."""
    costs, errors = frontier(rivals)
    if np.log(error) < errors[-1]:
        return None
    return float(np.exp(np.interp(-np.log(error), -errors, costs)))


def better(one: Measured, rivals: list[Measured], error: float | None) -> str:
    """Return who has the smaller error at the cost of `one`, where rivals have `error`."""
    rival = rivals[0].family
    if error is None:
        return f"{one.family} (no {rival} so cheap)"
    if abs(one.error / error - 1) < CLEAR:
        return "neither"
    if one.error < error and one.cost > max(other.cost for other in rivals):
        return f"{one.family} (no {rival} so dear)"
    return one.family if one.error < error else rival


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="little data, few updates; writes no file"
    )
    is_quick = parser.parse_args().quick
    effort = QUICK if is_quick else THOROUGH
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        system, definition, _ = resolve(str(floating_humanoid(folder)))
        wanted = {
            "system": system,
            "definition": definition,
            "substeps": SUBSTEPS,
            "samples_per_run": 36,
        }
        data = simulate_transitions(DatasetConfig(**wanted, count=effort.windows))
        measured, test, physics = measure(data, effort, folder)
    rows = [row(one, measured, physics) for one in measured]
    if not is_quick:
        write_csv(Path(__file__).parent / "results" / "humanoid.csv", rows)
    print(describe_machine())
    print(", ".join(f"{name}: {error:.3f}" for name, error in baselines(data, test).items()))
    print(
        f"{test.system.scheme.integrator} at the model's own step: {physics:.0f} µs per super step"
    )
    print_table(rows)


if __name__ == "__main__":
    main()
