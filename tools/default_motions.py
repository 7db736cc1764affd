"""Find the motions that shipped systems are shown in, and write them beside the emulators.

python -m tools.default_motions               all of them: some minutes
python -m tools.default_motions truck lander  some of them
python -m neuroanimator_studio.ship --facts           afterwards: the studio's bundles, which show them too

All are motions of the usual emulator, within its training data (tests/animation/test_default_motions.py). For dolphin
and truck leaving them is a cost; the others stay within by themselves.
"""

from __future__ import annotations

import argparse
import json

import numpy as np

import neuroanimator as na
from neuroanimator.animation.motion import Drive, random_drive
from neuroanimator.control import EmulatorPlant, Planner, Spline, Steered, control_plant
from neuroanimator.control.objective.goals import goal_start
from neuroanimator.control.objective.objective import CostTerm
from neuroanimator.control.objective.obstacles import Zone
from neuroanimator.emulator.trust_summary import summary_of
from neuroanimator.files.atomic import write_whole
from neuroanimator.files.zoo import DEFAULT_MOTIONS
from neuroanimator.learn.tasks import TRUCK_PROBES, lot_zones
from neuroanimator.learn.tasks.rigid import landing_objective
from neuroanimator_studio.description import short_numbers

WANDERED = 5.0
"""Length of a soft body's motion [s]."""

WANDERINGS = 200
"""Number of paths the liveliest is taken of."""

EDGE = 0.9
"""Trust's score that such a motion stays below."""

PLANNED = 20
"""Super steps a plan looks ahead while the arm is held upright: a second."""


def leap(emulator: na.Emulator, system: na.System) -> Drive:
    """Return a dolphin that gathers speed, leaves the water, dives in nose first and swims on (examples/09_leap.py)."""
    depth, seconds, tempo, top, entry = 2.95, 4.2, 1.25, 3.3, 3.8
    steps = round(seconds / emulator.dt)
    start = np.array(system.rest)
    start[2 : 3 * 23 : 3] -= depth
    gait = system.gait
    bounds = na.Bounds.symmetric(np.where(np.array(gait.amplitudes) == 0, 1e-3, 1.0))
    times = np.arange(steps) * emulator.dt
    bend = np.interp(times, [0.0, 0.858, 2.4, seconds], [0.0, 0.341, 0.0, -0.046])
    strokes = 0.767 * gait.controls(steps, emulator.dt, bounds, tempo=tempo)
    objective = na.Objective.of(
        *leap_costs(system, na.reach_height(system, 0.803, within=0.1, at=top), entry, 0.13),
        na.stay_trusted(emulator, threshold=0.453, weight=313.0),
    )
    options = na.DescentOptions(
        parametrisation=Steered.of(steps, emulator.dt, gait.period / tempo, 7, bounds),
        first=strokes + bend[:, None] * np.sign(gait.amplitudes),
    )
    found = na.descend(emulator, objective, start, steps=steps, options=options)
    onward = gait.controls(round(0.6 / emulator.dt), emulator.dt, emulator.bounds)
    return Drive(start, emulator.bounds.clip(np.concatenate([found.controls, onward])))


def leap_costs(system: na.System, height: CostTerm, entry: float, within: float) -> list[CostTerm]:
    """Return the costs of a leap to a `height`, back up, that dives in nose first, `within` [rad], at the time `entry` [s]."""
    nose_first = [np.cos(np.radians(38)), 0, -np.sin(np.radians(38))]
    return [
        na.effort(0.003),
        na.smoothness(0.0003),
        na.stay_upright(system, may_pitch=True),
        height,
        na.reach_heading(system, nose_first, within=within, at=entry),
    ]


def swim(emulator: na.Emulator, system: na.System) -> Drive:
    """Return an animal that swims by its gait."""
    return random_drive(emulator, None, 0)


def land(emulator: na.Emulator, system: na.System) -> Drive:
    """Return a lander that is upright over its pad and sinks onto it slowly."""
    seconds, last = 7.0, 1.5
    steps = round(seconds / emulator.dt)
    objective = landing_objective(system, seconds - last)
    descent = na.DescentOptions(starts=4, parametrisation=Spline.of(steps, 20, system.bounds))
    start = goal_start(system, "pad")
    options = na.SearchOptions(descent, refinements=0)
    found = na.synthesise(emulator, system, objective, start, steps=steps, options=options)
    return Drive(start, found.controls)


def swing_up(emulator: na.Emulator, system: na.System) -> Drive:
    """Return an arm that swings itself up in one plan of 1.5 s, and is held upright for a second by planning again and again."""
    objective = na.Objective.of(na.effort(), na.goal(system, "upright"))
    found = na.descend(emulator, objective, system.rest, steps=round(1.5 / emulator.dt))
    standing = na.goal(system, "upright", since=0, weight=1 / emulator.dt)
    planner = Planner.of(emulator, na.Objective.of(na.effort(), standing), PLANNED)
    state = np.asarray(emulator.rollout(system.rest, found.controls), float)[-1]
    held = control_plant(planner, EmulatorPlant(emulator), state, round(1.0 / emulator.dt))
    return Drive(np.array(system.rest), np.concatenate([found.controls, held.controls]))


def swing(emulator: na.Emulator, system: na.System) -> Drive:
    """Return an arm without motors, held out level and let go, for the time in which most of its swing is gone."""
    start = emulator.rest
    start[0] = np.pi / 2
    steps = round(7.0 / emulator.dt)
    return Drive(start, np.repeat(emulator.bounds.middle[None], steps, axis=0))


def park(emulator: na.Emulator, system: na.System) -> Drive:
    """Return a truck that drives past a bay and backs into it."""
    steps = round(12.0 / emulator.dt)
    start = np.array(system.rest)
    start[:2] = [-4.5, -0.5]
    # It turns well before the post ahead, which else seems to stand on its bonnet.
    before_post = Zone((9.0, 0.0), half=(3.5, 6.0))
    zones = [*lot_zones(system), before_post]
    objective = na.Objective.of(
        na.effort(0.02),
        na.smoothness(0.02),
        na.goal(system, "bay_2"),
        na.avoid(system, zones, probes=TRUCK_PROBES, margin=1.25, weight=300.0),
        na.stay_trusted(emulator, threshold=0.6, weight=50.0),
    )
    descent = na.DescentOptions(starts=4, parametrisation=Spline.of(steps, 16, system.bounds))
    options = na.SearchOptions(descent, refinements=0)
    found = na.synthesise(emulator, system, objective, start, steps=steps, options=options)
    return Drive(start, found.controls)


def wander(emulator: na.Emulator, system: na.System) -> Drive:
    """Return a soft body along the liveliest of some smooth random paths that stay within training."""
    rng = np.random.default_rng(0)
    steps = round(WANDERED / emulator.dt)
    drives = []
    ways = []
    for controls in system.sample_paths(rng, WANDERINGS, steps, emulator.dt):
        drive = Drive(np.array(system.rest), controls)
        _, scores = drive.trusted_motion(emulator)
        if scores.max() < EDGE:
            drives.append(drive)
            ways.append((controls / np.array(emulator.bounds.high)).std())
    return drives[int(np.argmax(ways))]


MOTIONS = {
    "dolphin": leap,
    "fish": swim,
    "fishes": swim,
    "trout": swim,
    "orca": swim,
    "lander": land,
    "pendulum": swing_up,
    "pendulum-passive": swing,
    "truck": park,
    "cape": wander,
    "flag": wander,
    "jelly": wander,
}
"""How the motion of each system is found."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="SYSTEM", help=", ".join(MOTIONS))
    motions = json.loads(DEFAULT_MOTIONS.read_text(encoding="ascii"))
    for name in parser.parse_args().names or MOTIONS:
        emulator = na.load_emulator(name)
        drive = MOTIONS[name](emulator, na.load_system(name))
        motions[name] = {
            "dt": emulator.dt,
            "start": short_numbers(drive.start),
            "controls": short_numbers(drive.controls),
        }
        lines = [f'"{key}":{_line_of(motions[key])}' for key in sorted(motions)]
        text = "{\n" + ",\n".join(lines) + "\n}\n"
        write_whole(DEFAULT_MOTIONS, text.encode("ascii"))
        _, scores = drive.trusted_motion(emulator)
        size = len(_line_of(motions[name]))
        print(f"{name}: {size / 1e3:.1f} kB, {summary_of(emulator, scores)}", flush=True)


def _line_of(motion: dict[str, object]) -> str:
    return json.dumps(motion, allow_nan=False, separators=(",", ":"))


if __name__ == "__main__":
    main()
