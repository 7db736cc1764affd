"""Bodies with fewer motors than joints, which have to pump: swing-ups from hanging, by `new`, `train` and `control` as they are.

python benchmarks/underactuated.py                    100 starts of each; results/underactuated.csv
python benchmarks/underactuated.py --starts 10 --dry  fewer; writes no file

Starts are near hanging. A swing-up counts if MuJoCo's own motion ends within 0.2 rad and 1 rad/s of upright in every joint.
`descents alone` is the same without the search for first guesses among random motions. Seconds are those of a call once
programs are compiled.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from neuroanimator import Emulator, load_emulator, load_system
from neuroanimator.control.synthesis.synthesise import synthesise_goal
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.systems.system import System
from neuroanimator.terminal import print_table

CASES = Path(__file__).parent / "underactuated_cases"

RESULTS = Path(__file__).parent / "results"

PROGRAM = Path(sys.executable).parent / "neuroanimator"

SECONDS = {"pendubot": 4.0, "three_links": 6.0}
"""Time a swing-up may take [s]."""

SPREAD = 0.1
"""Standard deviation of angles [rad], and half that of velocities [rad/s], at the start."""

WAYS = {"descents alone": 0, "as it is": 1}
"""Number of wide searches where a goal is missed."""

GOAL = """
[goals.up]
seconds = {seconds}
reach = {{ {reach} }}
within = {{ {within} }}
"""


def prepared(name: str, folder: Path) -> tuple[Emulator, System]:
    """Return (the emulator, the physics) of a body, as `new` and `train` make them; its goal is to stand upright."""
    (folder / f"{name}.xml").write_bytes((CASES / f"{name}.xml").read_bytes())
    _run(folder, "new", f"{name}.xml")
    toml = folder / f"{name}.toml"
    out = f"{name}.emulator.safetensors"
    _run(folder, "train", toml.name, "--out", out)
    joints = [part.name for part in load_system(str(toml)).state.slices if part.unit == "rad"]
    angles = [f'"{joint}" = [{np.pi if joint == joints[0] else 0.0}]' for joint in joints]
    velocities = [f'"{joint}.velocity" = [0.0]' for joint in joints]
    within = [f'"{joint}" = 0.2' for joint in joints]
    within += [f'"{joint}.velocity" = 1.0' for joint in joints]
    text = GOAL.format(
        seconds=SECONDS[name], reach=", ".join([*angles, *velocities]), within=", ".join(within)
    )
    toml.write_text(toml.read_text(encoding="utf-8") + text, encoding="utf-8")
    return load_emulator(folder / out), load_system(str(toml))


def _run(folder: Path, *arguments: str) -> None:
    subprocess.run([PROGRAM, *arguments], cwd=folder, check=True, capture_output=True)


def row_of(name: str, way: str, emulator: Emulator, system: System, starts: int) -> dict[str, Any]:
    """Return how many of random starts end upright on the physics, and how long the search took."""
    rng = np.random.default_rng(1)
    joints = emulator.state.size // 2
    spread = np.repeat([SPREAD, 2 * SPREAD], joints)
    reached = []
    seconds = []
    costs = []
    for _ in range(starts):
        start = emulator.rest + rng.normal(size=emulator.state.size) * spread
        began = time.perf_counter()
        found = synthesise_goal(
            emulator, "up", start=start, goals_from=system, restarts=WAYS[way], minutes=0
        )
        seconds.append(time.perf_counter() - began)
        reached.append(bool(found.is_reached))
        costs.append(found.outcome.cost_physics)
    return {
        "body": name,
        "way": way,
        "starts": starts,
        "upright": sum(reached),
        "seconds_median": float(np.median(seconds)),
        "seconds_longest": float(np.max(seconds[1:])),
        "cost_median": float(np.median(costs)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, default=100, help="number of starts of each body")
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    rows = []
    for name in SECONDS:
        with TemporaryDirectory() as place:
            emulator, system = prepared(name, Path(place))
            for way in WAYS:
                rows.append(row_of(name, way, emulator, system, arguments.starts))
                print_table(rows[-1:])
    if not arguments.dry:
        write_csv(RESULTS / "underactuated.csv", rows)
    print_table(rows)
    print(describe_machine())


if __name__ == "__main__":
    main()
