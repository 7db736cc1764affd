"""Bodies with fewer motors than joints, which have to pump: swing-ups from hanging, by defaults of `new`, `train` and `control`.

python -m benchmarks.control.underactuated                    100 starts of each; underactuated.csv
python -m benchmarks.control.underactuated --starts 10 --dry  fewer; writes no file

Starts are near hanging. A swing-up counts if MuJoCo's own motion ends within 0.2 rad and 1 rad/s of upright in every joint.
`descents alone` is the same without the search for initial guesses among random motions. In closed loop a body counts if it is
upright, on MuJoCo, throughout the last 10 s of 12 s after its swing-up. Seconds are until the controls are found, without
compilation.
"""

from __future__ import annotations

import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.harness import PROGRAM, keep_rows, parser_of, show_rows
from neuroanimator import Emulator, load_emulator, load_system
from neuroanimator.control import pursue_goal
from neuroanimator.control.synthesis.attempt import SearchOptions
from neuroanimator.control.synthesis.synthesise import RESTARTS, synthesise_goal
from neuroanimator.systems.system import System

Row = dict[str, Any]

HERE = Path(__file__).parent

SECONDS = {"pendubot": 4.0, "three_links": 6.0}
"""Time a swing-up may take [s]."""

SPREAD = 0.1
"""Standard deviation of angles [rad], and half that of velocities [rad/s], at the start."""

WAYS = {"descents alone": 0, "with the search": RESTARTS}
"""Maximum number of wide searches where a goal is missed."""

SETTLED = 2.0
"""Time after a swing-up from which a body must be upright [s]."""

HELD = 10.0
"""Time for which it must be upright from then on [s]."""

GOAL = """
[goals.up]
seconds = {seconds}
reach = {{ {reach} }}
within = {{ {within} }}
"""


def prepared(name: str, folder: Path) -> tuple[Emulator, System]:
    """Return (the emulator, the physics) of a body, as `new` and `train` make them; its goal is to stand upright."""
    (folder / f"{name}.xml").write_bytes((HERE / f"{name}.xml").read_bytes())
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


def starts_of(emulator: Emulator, count: int) -> list[np.ndarray]:
    """Return random states near hanging."""
    rng = np.random.default_rng(1)
    joints = emulator.state.size // 2
    spread = np.repeat([SPREAD, 2 * SPREAD], joints)
    return [emulator.rest + rng.normal(size=2 * joints) * spread for _ in range(count)]


def swing_up_row(name: str, way: str, emulator: Emulator, system: System, count: int) -> Row:
    """Return how many of random starts end upright on the physics, and how long the search took."""
    upright = []
    seconds = []
    for start in starts_of(emulator, count):
        began = time.perf_counter()
        options = SearchOptions(restarts=WAYS[way])
        found = synthesise_goal(emulator, system, "up", start=start, options=options)
        seconds.append(time.perf_counter() - began)
        upright.append(bool(found.is_reached))
    return row_of(name, way, upright, seconds)


def held_row(name: str, emulator: Emulator, system: System, count: int) -> Row:
    """Return how many come up from random starts and stay up on the physics, and how long the search took."""
    held = []
    seconds = []
    long = SECONDS[name] + SETTLED + HELD
    for start in starts_of(emulator, count):
        pursuit = pursue_goal(emulator, system, "up", long, start=start)
        held.append(bool(pursuit.is_at_goal[-round(HELD / emulator.dt) :].all()))
        seconds.append(pursuit.search_seconds)
    return row_of(name, "in closed loop, and held", held, seconds)


def row_of(name: str, way: str, upright: list[bool], seconds: list[float]) -> Row:
    return {
        "body": name,
        "way": way,
        "starts": len(upright),
        "upright": sum(upright),
        "seconds_median": float(np.median(seconds)),
        "seconds_longest": float(np.max(seconds[1:])),
    }


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--starts", type=int, default=100, help="number of starts of each body")
    arguments = parser.parse_args()
    rows = []
    for name in SECONDS:
        with TemporaryDirectory() as place:
            emulator, system = prepared(name, Path(place))
            for way in WAYS:
                rows.append(swing_up_row(name, way, emulator, system, arguments.starts))
                show_rows(rows[-1:])
            rows.append(held_row(name, emulator, system, arguments.starts))
            show_rows(rows[-1:])
    show_rows(rows)
    keep_rows(HERE / "underactuated.csv", rows, arguments)


if __name__ == "__main__":
    main()
