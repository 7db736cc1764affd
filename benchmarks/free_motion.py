"""Free motions of 8 to 17 s, emulated beside MuJoCo at the model's own step; results/free_motion.csv.

python benchmarks/free_motion.py            half an hour on two cores; needs Gymnasium, whose ant it takes
python benchmarks/free_motion.py cartpole   one of the bodies; the other's lines stay
python benchmarks/free_motion.py --quick    little data, few updates; writes no file
python benchmarks/free_motion.py --folder F keeps datasets and emulators in the folder F

The protocol of NeRD (Xu et al. 2025, arXiv 2508.15755): a cart-pole for 1,000 and an ant for 500 steps of 1/60 s from
random starts, no control. Errors are distances from MuJoCo in fine steps, means over time and over the starts. Bodies
are ours and Gymnasium's, and their engine differs. An ant of the physics that stops dead after a second shows how much of
the errors is creeping. The cart-pole's emulator has the settings that `new` proposes, and a million transitions. The ant's
has 240,000: the controls of half of its runs stop at some point, errors of calm windows count as much as those of wild ones
in relation to the motion, its layers are narrower than usual, for at most 100,000 weights, and its updates fewer.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from neuroanimator import Emulator, TrainingConfig
from neuroanimator.data.config import DatasetConfig
from neuroanimator.data.generate import generate
from neuroanimator.data.store import read_transitions
from neuroanimator.evaluation.csv_table import merge_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.evaluation.speed import interleaved
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.loading import resolve, trust_files
from neuroanimator.systems.system import System
from neuroanimator.terminal import print_table
from neuroanimator.training.train import train

TABLE = Path(__file__).parent / "results" / "free_motion.csv"

FRAME = 1 / 60
"""Length of a step of the protocol [s]."""

TRANSITIONS = 1_000_000

QUICK_TRANSITIONS = 36_000

QUICK_UPDATES = 1_000

STARTS = 100
"""Number of random starts."""

TEST_SEED = 2**31
"""Seed of the starts, above any of a dataset's."""


PARTS = ("position", "orientation", "joints")
"""Errors of the table, each of several parts of the state."""


class Case(NamedTuple):
    """A body of the protocol."""

    name: str
    model: str
    """Arguments of `new`."""
    frames: int
    """Number of steps of the protocol."""
    sample: Callable[[System, np.random.Generator], Float[np.ndarray, " S"]]
    """Draws a start."""
    data: dict[str, Any]
    """What of the dataset is not as usual."""
    training: dict[str, Any]
    """What of the training is not as usual."""
    parts: dict[str, tuple[str, ...]]
    """Names of the parts of the state that share an error, by its name."""
    landed: float | None = None
    """Time by which the body has landed [s]; None for one that does not."""


def sample_cartpole(system: System, rng: np.random.Generator) -> Float[np.ndarray, " S"]:
    """Draw positions and velocities up to 1 m, 1 m/s and 1 rad/s, and any angle."""
    return rng.uniform(-1, 1, system.state.size) * [1, np.pi, 1, 1]


def sample_ant(system: System, rng: np.random.Generator) -> Float[np.ndarray, " S"]:
    """Draw an ant that is about to land on its feet: tilted by up to 30°, slow."""
    state = system.rest.copy()
    at = system.state.index
    state[at("root.position")] = [0, 0, 1] + rng.uniform(-1, 1, 3) * [0.2, 0.2, 0.1]
    axis = rng.uniform(-1, 1, 3)
    half = rng.uniform(-1, 1) * np.pi / 12
    state[at("root.orientation")] = [np.cos(half), *np.sin(half) * axis / np.linalg.norm(axis)]
    state[at("root.velocity")] = rng.uniform(-0.1, 0.1, 3)
    state[at("root.angular_velocity")] = rng.uniform(-0.25, 0.25, 3)
    for joint, angle in zip(ANT_JOINTS, ANT_STANCE, strict=True):
        state[at(joint)] = angle + rng.uniform(-0.2, 0.2)
        state[at(f"{joint}.velocity")] = rng.uniform(-0.25, 0.25)
    return state


ANT_JOINTS = tuple(f"{part}_{leg}" for leg in (1, 2, 3, 4) for part in ("hip", "ankle"))

ANT_STANCE = (0.0, 1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0)
"""Angles of these joints where the ant stands [rad]."""

CASES = (
    Case(
        "cartpole",
        str(Path(__file__).parent / "free_motion_cases" / "cartpole.xml"),
        1000,
        sample_cartpole,
        {},
        {},
        {"position": ("slider",), "joints": ("hinge",)},
    ),
    Case(
        "ant",
        "Ant-v5",
        500,
        sample_ant,
        {"idle_share": 0.5, "count": 240_000},
        {"widths": (176, 128), "calm": 1e-3, "updates": 8_000},
        {
            "position": ("root.position",),
            "orientation": ("root.orientation",),
            "joints": ANT_JOINTS,
        },
        landed=1.0,
    ),
)

ORDER = [case.name for case in CASES]


def rows_of(case: Case, folder: Path, *, is_quick: bool) -> list[dict[str, Any]]:
    """Return a body's lines of the table: the emulator's, and the physics' at the model's own step."""
    began = time.perf_counter()
    toml, _ = write_definition(case.model, folder / f"{case.name}.toml")
    trust_files(toml)
    name, definition, substeps = resolve(str(toml))
    data_settings = {"count": TRANSITIONS} | case.data
    training_settings = dict(case.training)
    if is_quick:
        data_settings["count"] = QUICK_TRANSITIONS
        training_settings["updates"] = QUICK_UPDATES
    dataset = DatasetConfig.usual(name, definition, substeps, **data_settings)
    generate(dataset, folder / "data")
    data = read_transitions(folder / "data")
    system = data.system
    config = TrainingConfig.usual(system.structure, **training_settings)
    emulator = train(data, config, folder / f"{case.name}.emulator.safetensors")
    made = time.perf_counter() - began
    rng = np.random.default_rng(TEST_SEED)
    starts = np.stack([case.sample(system, rng) for _ in range(STARTS)])
    steps = round(case.frames * FRAME / emulator.dt)
    controls = np.tile(system.bounds.idle, (STARTS, steps, 1))
    fine = system.simulate(starts, controls, emulator.dt, scheme=system.fine).states
    own = system.simulate(starts, controls, emulator.dt, scheme=system.scheme).states
    emulated = np.asarray(emulator.rollout(starts, controls), float)
    seconds = seconds_of(emulator, system, starts[0], controls[0])
    weights = sum(leaf.size for leaf in jax.tree.leaves(emulator.network))
    motions = {"emulator": emulated, "MuJoCo, the model's own step": own}
    if case.landed is not None:
        motions["held still once landed"] = held_still(fine, round(case.landed / emulator.dt))
    rows = []
    for method, states in motions.items():
        row = {"case": case.name, "method": method, "super_step_s": emulator.dt, "steps": steps}
        row |= errors_of(case, system, states, fine)
        row["frames_a_second"] = case.frames / seconds[method] if method in seconds else ""
        made_of = (dataset.count, weights, made) if method == "emulator" else ("", "", "")
        row |= dict(zip(("transitions", "weights", "making_s"), made_of, strict=True))
        rows.append(row)
    return rows


def held_still(states: Float[np.ndarray, "B T S"], step: int) -> Float[np.ndarray, "B T S"]:
    """Return motions that stop dead after a number of super steps."""
    held = states.copy()
    held[:, step:] = states[:, step : step + 1]
    return held


def errors_of(
    case: Case,
    system: System,
    states: Float[np.ndarray, "B T S"],
    fine: Float[np.ndarray, "B T S"],
) -> dict[str, Any]:
    """Return errors of positions [m], orientations and joints [rad]: means over the way, and medians at its end."""
    columns: dict[str, Any] = {}
    for name in PARTS:
        parts = case.parts.get(name, ())
        if not parts:
            columns |= {f"{name}_mean": "", f"{name}_end_median": ""}
            continue
        off = np.concatenate(
            [difference(system, part, states[:, 1:], fine[:, 1:]) for part in parts], axis=-1
        )
        columns[f"{name}_mean"] = float(off.mean())
        columns[f"{name}_end_median"] = float(np.median(off[:, -1]))
    return columns


def difference(
    system: System,
    part: str,
    states: Float[np.ndarray, "B T S"],
    fine: Float[np.ndarray, "B T S"],
) -> Float[np.ndarray, "B T k"]:
    """Return how far a part of the state is off [m or rad]; one number of a position or an orientation."""
    where = system.state.index(part)
    first, second = states[..., where], fine[..., where]
    if part.endswith(".orientation"):
        cosine = np.abs((first * second).sum(axis=-1, keepdims=True)).clip(max=1)
        return 2 * np.arccos(cosine)
    if part == "hinge":
        return np.abs((first - second + np.pi) % (2 * np.pi) - np.pi)
    return np.linalg.norm(first - second, axis=-1, keepdims=True)


def seconds_of(
    emulator: Emulator, system: System, start: Float[np.ndarray, " S"], controls: np.ndarray
) -> dict[str, float]:
    """Return how long one motion takes [s] on one core: emulated in C, and by MuJoCo."""

    def step_physics() -> None:
        system.simulate(start[None], controls[None], emulator.dt, scheme=system.scheme)

    start32 = start.astype(np.float32)
    controls32 = controls.astype(np.float32)
    players: dict[str, Callable[[], Any]] = {
        "emulator": lambda: emulator.rollout(start32, controls32),
        "MuJoCo, the model's own step": step_physics,
    }
    return interleaved(players)


def keep(rows: list[dict[str, Any]]) -> None:
    """Write `rows` into the table, in place of the same bodies' older lines."""
    merge_csv(TABLE, rows, "case", order=lambda row: ORDER.index(row["case"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", nargs="*", help="the bodies; both if none is named")
    parser.add_argument("--quick", action="store_true", help="little data; writes no file")
    parser.add_argument("--folder", type=Path, help="keep what is made in this folder")
    arguments = parser.parse_args()
    for case in CASES:
        if arguments.cases and case.name not in arguments.cases:
            continue
        with tempfile.TemporaryDirectory() as scratch:
            folder = (arguments.folder or Path(scratch)) / case.name
            folder.mkdir(parents=True, exist_ok=True)
            rows = rows_of(case, folder, is_quick=arguments.quick)
        print_table(rows)
        if not arguments.quick:
            keep(rows)
    print(describe_machine())


if __name__ == "__main__":
    main()
