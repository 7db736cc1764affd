"""Fish of unknown length, stiffness and density swim at commanded speeds and headings, by policies of their family.

python benchmarks/family_policies.py               trains two policies, ten minutes of a core each, and lets 20 fish swim
python benchmarks/family_policies.py --bodies 1 --dry

The policy of the family is given the true parameters, those that its pilot estimates online, the length alone (which the shape
shows), or nominal ones. A robust policy learnt from the same bodies without parameters. Every fish begins at rest on the true
physics and gets another speed and heading every five seconds, six times. Errors are root mean squares of the errors of speed and
heading at the end of each command.

Writes results/family_policies.csv, a line per fish and method, and medians.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import neuroanimator as na
from neuroanimator.control import EmulatorPlant, ParameterEstimator, PhysicsPlant
from neuroanimator.control.planning.plants import Plant
from neuroanimator.control.policies import PolicyTraining, train_policy
from neuroanimator.evaluation.csv_table import write_csv
from neuroanimator.evaluation.machine import describe_machine
from neuroanimator.terminal import print_table

Rows = list[dict[str, Any]]

TABLE = Path(__file__).parent / "results" / "family_policies.csv"

COMMANDS = 6
"""Number of commands of a swim."""

COMMAND_SECONDS = 5.0
"""Time of a command [s]."""

TURN_SECONDS = 2.0
"""Time at its begin in which the heading is turned [s]."""

MAX_TURN = 1.0
"""Largest change of the heading [rad]."""

SHARES = (0.3, 0.8)
"""Commanded speeds, as shares of what each fish's own gait does at full strength."""

JUDGED_PERIODS = 2
"""Number of periods of the gait at the end of a command in which speed and heading count."""

GAIT_SECONDS = 8.0
"""Time after which a gait is under way [s]."""

FIRST_SEED = 100
"""Seed of the first fish."""


Teller = Callable[[np.ndarray], np.ndarray]
"""(true state (S,)) → the state that the pilot is handed."""


class Command(NamedTuple):
    """Commands of a fish."""

    speed: float
    """[m/s]"""
    turn: float
    """Change of the heading, to the left [rad]."""


class Fish(NamedTuple):
    """One fish of the family, at rest, and its commands."""

    seed: int
    rest: Float[np.ndarray, " S"]
    commands: list[Command]


def random_fish(system: Any, fastest: float, dt: float, seed: int) -> Fish:
    """Return a random fish and commands that it can follow, at most `fastest` [m/s]."""
    rng = np.random.default_rng(seed)
    parameters = {p.name: rng.uniform(p.low, p.high) for p in system.parameters}
    rest = system.at(**parameters).rest
    own = min(gait_speed(system, rest, dt), fastest)
    commands = []
    for _ in range(COMMANDS):
        speed = own * rng.uniform(*SHARES)
        commands.append(Command(speed, rng.uniform(-MAX_TURN, MAX_TURN)))
    return Fish(seed, rest, commands)


def gait_speed(system: Any, rest: Float[np.ndarray, " S"], dt: float) -> float:
    """Return how fast the gait at full strength drives a true fish [m/s]."""
    steps = round(GAIT_SECONDS / dt)
    controls = system.gait.controls(steps, dt, system.bounds)
    states = system.simulate_fastest(rest[None], controls[None], dt).states[0]
    positions = na.read_pose(system.structure, states).position
    judged = JUDGED_PERIODS * round(system.gait.period / dt)
    travelled = np.linalg.norm(positions[-1] - positions[-1 - judged])
    return float(travelled) / (judged * dt)


def swim(pilot: na.Pilot, system: Any, plant: Plant, fish: Fish, told: Teller) -> dict[str, float]:
    """Return how far a fish is off its commands, where the pilot is handed its states as `told`."""
    dt = pilot.policy.dt
    steps = round(COMMAND_SECONDS / dt)
    turning = round(TURN_SECONDS / dt)
    judged = JUDGED_PERIODS * round(system.gait.period / dt)
    state = fish.rest
    heading = 0.0
    pilot.reset(told(state))
    speed_errors = []
    shares = []
    heading_errors = []
    efforts = []
    for command in fish.commands:
        states = []
        heading += command.turn
        for step in range(steps):
            turn = command.turn / TURN_SECONDS if step < turning else 0.0
            pilot.step(speed=command.speed, turn=turn, dt=dt, state=told(state))
            state = plant(state, pilot.controls)
            states.append(state)
            efforts.append(np.mean((pilot.controls / system.bounds.magnitude) ** 2))
        pose = na.read_pose(system.structure, np.array(states[-judged:]))
        speed = np.sum(pose.velocity * pose.forward, axis=-1).mean()
        forward = pose.forward.mean(axis=0)
        off = math.atan2(forward[1], forward[0]) - heading
        speed_errors.append(speed - command.speed)
        shares.append(speed / command.speed - 1)
        heading_errors.append((off + math.pi) % (2 * math.pi) - math.pi)
    return {
        "speed_error_mps": rms(speed_errors),
        "speed_error_percent": 100 * rms(shares),
        "heading_error_deg": math.degrees(rms(heading_errors)),
        "effort": float(np.mean(efforts)),
    }


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


class Method(NamedTuple):
    """A way to steer a fish that nobody measured."""

    policy: na.Policy
    label: str
    """What the policy is of."""
    parameters: str
    """Parameters that it is given: true, estimated, length, nominal."""
    is_emulated: bool = False
    """Whether the emulator of the true body moves the fish, instead of the physics."""


def methods_of(given: na.Policy, robust: na.Policy) -> list[Method]:
    """Return what is compared."""
    return [
        Method(na.load_policy("fish"), "one fish", "none"),
        Method(robust, "robust", "length"),
        Method(given, "family", "nominal"),
        Method(given, "family", "length"),
        Method(given, "family", "estimated"),
        Method(given, "family", "true"),
        Method(given, "family", "true", is_emulated=True),
    ]


def rows_of(system: Any, methods: list[Method], bodies: int) -> Rows:
    """Return a line for each fish and method."""
    family = methods[-1].policy
    emulator = family.emulator
    entries = list(emulator.parameter_entries)
    names = [parameter.name for parameter in system.parameters]
    ranges = np.array([parameter.high - parameter.low for parameter in system.parameters])
    length = entries[names.index("length")]
    nominal = system.rest[entries]
    rows: Rows = []
    for seed in range(FIRST_SEED, FIRST_SEED + bodies):
        fish = random_fish(system, family.ranges.high[0], emulator.dt, seed)
        for method in methods:
            plant: Plant = PhysicsPlant(system, emulator.dt)
            if method.is_emulated:
                plant = EmulatorPlant(emulator)
            estimator = None
            if method.parameters == "estimated":
                estimator = ParameterEstimator(emulator)
            pilot = na.Pilot(method.policy, estimator=estimator)

            def told(state: np.ndarray, method: Method = method) -> np.ndarray:
                if method.parameters == "none":
                    return state[: entries[0]]
                told = state.copy()
                if method.parameters != "true":
                    told[entries] = nominal
                if method.parameters == "length":
                    told[length] = state[length]
                return told

            row: dict[str, Any] = {"seed": seed, "policy": method.label}
            row["parameters"] = method.parameters
            row["on"] = "emulator" if method.is_emulated else "physics"
            row |= swim(pilot, system, plant, fish, told)
            off = math.nan
            if estimator is not None:
                off = float(np.mean(np.abs(estimator.values - fish.rest[entries]) / ranges))
            row["parameter_error"] = off
            rows.append(row)
        print_table(rows[-len(methods) :])
    return rows


ERRORS = (
    "speed_error_mps",
    "speed_error_percent",
    "heading_error_deg",
    "effort",
    "parameter_error",
)
"""Columns whose medians are written."""


def medians(rows: Rows, methods: list[Method]) -> Rows:
    """Return the medians of each method."""
    lines: Rows = []
    for index in range(len(methods)):
        own = rows[index :: len(methods)]
        line: dict[str, Any] = own[0] | {"seed": "median"}
        for key in ERRORS:
            line[key] = float(np.median([row[key] for row in own]))
        lines.append(line)
    return lines


def trained(folder: Path, name: str, training: PolicyTraining) -> na.Policy:
    """Return the policy of the family, from `folder` if it lies there, else trained and put there."""
    path = folder / f"{name}.policy.safetensors"
    if not path.exists():
        train_policy(
            na.load_emulator("fishes"),
            na.load_system("fishes"),
            path,
            training,
            on_report=print,
        )
    return na.load_policy(path)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--policies", type=Path, default=Path("out/policies"))
    parser.add_argument("--bodies", type=int, default=20)
    parser.add_argument("--dry", action="store_true", help="write no file")
    arguments = parser.parse_args()
    print(describe_machine())
    given = trained(arguments.policies, "fishes", PolicyTraining())
    robust = trained(arguments.policies, "fishes-robust", PolicyTraining(observes_parameters=False))
    methods = methods_of(given, robust)
    rows = rows_of(na.load_system("fishes"), methods, arguments.bodies)
    rows += medians(rows, methods)
    print_table(rows[-len(methods) :])
    if not arguments.dry:
        write_csv(TABLE, rows)


if __name__ == "__main__":
    main()
