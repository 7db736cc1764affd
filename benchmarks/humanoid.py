"""Does a network per limb pay? MuJoCo's humanoid, floating freely; writes results/humanoid.csv.

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
from jaxtyping import Float

from neuroanimator import TrainingConfig
from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.data.store import Transitions
from neuroanimator.emulator.emulator import Emulator
from neuroanimator.evaluation.accuracy import one_step_error, root_mean_square
from neuroanimator.evaluation.baselines import baselines
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.held_out import HeldOut, held_out_runs
from neuroanimator.evaluation.machine import describe_machine
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
"""Number of physics steps in a super step, of 3 ms each, the model's own."""

SAMPLES_PER_RUN = 36
"""Number of transitions in a run of the dataset."""

TEST_SECONDS = 3.0
"""Length of a run the errors are measured on [s]."""

ROOT_ENTRIES = 6
"""Numbers of the positions' changes, and of the velocities', that the root takes."""

GROUPS = """
[groups]
torso = ["abdomen_z", "abdomen_y", "abdomen_x"]
right_leg = ["right_hip_x", "right_hip_z", "right_hip_y", "right_knee"]
left_leg = ["left_hip_x", "left_hip_z", "left_hip_y", "left_knee"]
right_arm = ["right_shoulder1", "right_shoulder2", "right_elbow"]
left_arm = ["left_shoulder1", "left_shoulder2", "left_elbow"]
"""
"""The limbs of the humanoid as its TOML file names them: a hierarchy gives each a network of its own."""

NETWORKS: dict[str, tuple[tuple[int, ...], ...]] = {
    "glu": ((96, 64),),
    "linear-glu": ((64, 48), (96, 64), (160, 96), (224, 128)),
    "hierarchy": ((64, 0, 24), (64, 48, 0, 24), (64, 48, 0, 48), (96, 64, 0, 64)),
}
"""The widths tried of each kind of network: networks that cost 2 to 4 µs a super step."""

CLEAR = 0.03
"""Errors must differ by this share to call one better: chosen, as one seed cannot show its own spread."""


@dataclass(frozen=True)
class Effort:
    """How much work the benchmark spends."""

    windows: int
    """The transitions of the dataset."""
    updates: int
    """The updates of a training run."""
    runs: int
    """The runs the errors are measured on."""
    repeats: int
    """The timings of each side."""
    widths: int
    """The networks of each kind, at most."""


THOROUGH = Effort(windows=108_000, updates=6_000, runs=32, repeats=25, widths=4)
"""The effort of the published table; 25 timings outlast a burst of other work on a shared machine."""

QUICK = Effort(windows=3_600, updates=500, runs=4, repeats=3, widths=1)
"""The effort with --quick."""


class Measured(NamedTuple):
    """One trained network."""

    kind: str
    """The kind of network: a key of `NETWORKS`."""
    emulator: Emulator
    errors: Float[np.ndarray, " V"]
    """The one-step error of each number of the change, over its standard deviation."""
    cost: float
    """The time of one super step [µs]."""

    @property
    def family(self) -> str:
        """Whether the network is `flat` or a `hierarchy`."""
        if self.kind == "hierarchy":
            return "hierarchy"
        return "flat"

    @property
    def error(self) -> float:
        """The root mean square of all errors."""
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
    definition = re.sub(r"(?m)^truth_step = \S+", "truth_step = 0.003", path.read_text())
    path.write_text(definition + GROUPS)
    return path


def measure(
    data: Transitions, effort: Effort, folder: Path
) -> tuple[list[Measured], HeldOut, float]:
    """Return the trained networks, the test, and the cost of the physics per super step [µs]."""
    kinds: list[str] = []
    emulators: list[Emulator] = []
    for kind, all_widths in NETWORKS.items():
        for widths in all_widths[: effort.widths]:
            kinds.append(kind)
            emulators.append(trained(data, kind, widths, effort.updates, folder))
    test = held_out_runs(emulators[0], effort.runs, seconds=TEST_SECONDS)
    assert isinstance(test.system, MujocoSystem)
    players = {str(i): emulator_player(emulator) for i, emulator in enumerate(emulators)}
    players["physics"] = physics_player(test.system, test, test.system.scheme.integrator)
    with one_core():
        spans = interleaved(players, effort.repeats)
    measured: list[Measured] = []
    for i, emulator in enumerate(emulators):
        cost = spans[str(i)] / TIMED_SUPER_STEPS * 1e6
        measured.append(Measured(kinds[i], emulator, one_step_error(emulator, test), cost))
    physics_cost = spans["physics"] / PHYSICS_STEPS * SUBSTEPS * 1e6
    return measured, test, physics_cost


def trained(
    data: Transitions, kind: Any, widths: tuple[int, ...], updates: int, folder: Path
) -> Emulator:
    """Return the best of a training run of single super steps."""
    config = TrainingConfig(network=kind, widths=widths, updates=updates, unroll=1)
    name = "-".join(str(width) for width in widths)
    return train(data, config, folder / f"{kind}-{name}.safetensors")


def row(network: Measured, networks: list[Measured], physics_cost: float) -> dict[str, Any]:
    """Return a network's line of the table, which compares it with those of the other family among `networks`."""
    count = len(network.emulator.state.names)
    velocities = count - count // 2
    root = [*range(ROOT_ENTRIES), *range(velocities, velocities + ROOT_ENTRIES)]
    baselines = [other for other in networks if other.family != network.family]
    error = baseline_error(network.cost, baselines)
    return {
        "network": network.kind,
        "widths": " ".join(str(width) for width in network.emulator.network.widths),
        "weights": weight_count(network.emulator),
        "error": network.error,
        "root_error": float(root_mean_square(network.errors[root])),
        "limb_error": float(root_mean_square(np.delete(network.errors, root))),
        "us": network.cost,
        "physics_over_it": physics_cost / network.cost,
        "baseline_error_at_its_cost": error or "",
        "baseline_us_at_its_error": baseline_cost(network.error, baselines) or "",
        "better_at_equal_cost": better(network, baselines, error),
    }


def weight_count(emulator: Emulator) -> int:
    """Return how many numbers the network has learnt."""
    leaves = jax.tree.leaves(emulator.network)
    return sum(leaf.size for leaf in leaves if isinstance(leaf, jax.Array))


def frontier(
    networks: list[Measured],
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Return logarithms of (costs, errors) of the networks no cheaper one of which is as exact, cheapest first."""
    best: list[Measured] = []
    for network in sorted(networks, key=lambda network: network.cost):
        if not best or network.error < best[-1].error:
            best.append(network)
    costs = np.log([network.cost for network in best])
    errors = np.log([network.error for network in best])
    return costs, errors


def baseline_error(cost: float, baselines: list[Measured]) -> float | None:
    """Return the error baselines have at that cost or less, between their widths by powers; None if none is as cheap."""
    costs, errors = frontier(baselines)
    if np.log(cost) < costs[0]:
        return None
    return float(np.exp(np.interp(np.log(cost), costs, errors)))


def baseline_cost(error: float, baselines: list[Measured]) -> float | None:
    """Return the cost at which baselines have that error; None if none is as exact."""
    costs, errors = frontier(baselines)
    if np.log(error) < errors[-1]:
        return None
    return float(np.exp(np.interp(-np.log(error), -errors, costs)))


def better(network: Measured, baselines: list[Measured], error: float | None) -> str:
    """Return which family has the smaller error at the cost of `network`, where baselines have `error`."""
    baseline_family = baselines[0].family
    if error is None:
        return f"{network.family} (no {baseline_family} so cheap)"
    if abs(network.error / error - 1) < CLEAR:
        return "neither"
    if network.error >= error:
        return baseline_family
    dearest = max(baseline.cost for baseline in baselines)
    if network.cost > dearest:
        return f"{network.family} (no {baseline_family} so dear)"
    return network.family


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="little data, few updates; writes no file"
    )
    is_quick = parser.parse_args().quick
    effort = THOROUGH
    if is_quick:
        effort = QUICK
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        system, definition, _ = resolve(str(floating_humanoid(folder)))
        config = DatasetConfig(
            system=system,
            definition=definition,
            substeps=SUBSTEPS,
            samples_per_run=SAMPLES_PER_RUN,
            count=effort.windows,
        )
        data = simulate_transitions(config)
        measured, test, physics_cost = measure(data, effort, folder)
    rows = [row(network, measured, physics_cost) for network in measured]
    if not is_quick:
        write_csv(Path(__file__).parent / "results" / "humanoid.csv", rows)
    print(describe_machine())
    baseline_errors = [f"{name}: {error:.3f}" for name, error in baselines(data, test).items()]
    print(", ".join(baseline_errors))
    integrator = test.system.scheme.integrator
    print(f"{integrator} at the model's own step: {physics_cost:.0f} µs per super step")
    print_table(rows)


if __name__ == "__main__":
    main()
