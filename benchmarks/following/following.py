"""A human who follows motions recorded from an actor: time of learning, share on the motion, slip of the feet.

python -m benchmarks.following.following  a walk, a jog and getting up, learnt from scratch; see UPDATES
python -m benchmarks.following.following jog --policy jog.policy.safetensors  one that 'neuroanimator policy' has learnt
python -m benchmarks.following.following walk --updates 400 --seed 2 --dry
python -m benchmarks.following.following walk --policy walk.policy.safetensors --sheet walk.png --dry

Each run is `neuroanimator policy` with examples/human/human.toml, with another clip for the jog, or with get-up.toml beside it.
Of 100 starts at random phases, without noise, those count that are on the motion after eleven rounds of it, or at the end of
getting up, never off by more than 0.25 m at the pelvis or 0.8 rad at the trunk. Slip is the distance per step that the lowest
point of a sole moves along the floor while within 5 mm of it, given beside that of the motion itself. Core seconds are CPU time,
the making of the emulator included; seconds are wall-clock time. Runs have a fixed number of updates, so other work on the
machine makes them longer, and changes nothing else.

Writes following.csv and following_curves.csv.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import neuroanimator as na
from benchmarks.harness import HUMAN, PROGRAM, Clocks, Rows, keep_rows, parser_of, show_rows
from neuroanimator.control.policies.state_policy import StatePolicy, load_state_policy
from neuroanimator.gym.bodies import Bodies, episodes_of, motion_of
from neuroanimator.gym.following import Following
from neuroanimator.gym.policy_task import PolicyTask, follow_table, task_of_policy
from neuroanimator.gym.state_rows import physics_stepper
from neuroanimator.physics import load_system
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from tools.contact_sheets import tile_motion
from tools.human_clips import soles

RESULTS = Path(__file__).parent

UPDATES = {"walk": 480, "jog": 1000, "get-up": 1200}
"""Number of updates of the policy, of 4,096 transitions each."""

STARTS = 100

FLOOR = 0.005
"""Height below which a sole is on the floor [m]."""

STEPS_IN_LAP = 2

TIMED_STEPS = 300
"""Number of super steps that are timed, of `TIMED_BODIES` each."""

TIMED_BODIES = 64

IMAGES = 12
"""Number of pictures on a contact sheet, of two rounds of the motion."""


def learn(clip: str, seed: int, updates: int, place: Path) -> tuple[Path, float, Rows]:
    """Return (the policy's file, seconds of a core's time it took, rows of its curve)."""
    for name in ("human.xml", f"{clip}.csv"):
        (place / name).write_bytes((HUMAN / name).read_bytes())
    shutil.copytree(HUMAN / "skin", place / "skin", dirs_exist_ok=True)
    own = HUMAN / f"{clip}.toml"
    toml = own if own.exists() else HUMAN / "human.toml"
    (place / "human.toml").write_text(toml.read_text().replace("walk.csv", f"{clip}.csv"))
    file = place / f"{clip}.policy.safetensors"
    began = Clocks.now()
    command = [PROGRAM, "policy", "human.toml", "--seed", seed, "--updates", updates, "--out", file]
    subprocess.run([str(part) for part in command], cwd=place, check=True, capture_output=True)
    core_seconds = began.passed().cpu_seconds
    return file, core_seconds, curve_of(file, {"clip": clip, "seed": seed})


def curve_of(policy: Path, labels: dict[str, Any]) -> Rows:
    """Return what the run that learnt a policy reported, with `labels`; nothing if its folder is not beside the file."""
    reports = policy.with_suffix(".run") / "metrics.jsonl"
    lines = reports.read_text().splitlines() if reports.exists() else []
    return [labels | json.loads(line) for line in lines]


def judged(policy: StatePolicy, task: PolicyTask, system: MujocoSystem) -> dict[str, Any]:
    """Return what a policy does on the physics."""
    motion = task.motion
    assert motion is not None
    stepper = physics_stepper(system, system.scheme, policy.dt)
    found = episodes_of(policy, stepper, task.rules, STARTS, 0)
    states = motion_of(policy, stepper, task.rules, task.steps, 1)
    table = follow_table(policy.emulator.definition)
    assert table is not None
    following = Following.of(motion, system, table)
    shown = jnp.asarray(states, jnp.float32)
    row = {
        "starts": STARTS,
        "on the motion": int(STARTS - found.is_fallen.sum()),
        "mean return": float(found.returns.mean()),
        "most possible": task.steps,
        "pelvis off m": float(following.distance(shown).mean()),
        "trunk off rad": float(following.tilt(shown).mean()),
    }
    if table.laps == 1:
        return row
    frames = np.asarray(motion.frames, float)[: 5 * motion.lap]
    return row | {
        "slip cm": 100 * slip(system, states, (len(states) - 1) / motion.lap),
        "slip of the clip cm": 100 * slip(system, frames, (len(frames) - 1) / motion.lap),
    }


def slip(system: MujocoSystem, states: Float[np.ndarray, "K S"], laps: float) -> float:
    """Return how far the lowest point of a sole moves along the floor while it is on it, a step [m], in `laps` of the motion."""
    points = np.array([soles(system.model, state[: system.model.nq]) for state in states])
    heights = points[..., 2]
    lowest = heights[:-1].argmin(axis=-1)[..., None]
    before = np.take_along_axis(heights[:-1], lowest, axis=-1)[..., 0]
    after = np.take_along_axis(heights[1:], lowest, axis=-1)[..., 0]
    moved = np.linalg.norm(np.diff(points[..., :2], axis=0), axis=-1)
    moved = np.take_along_axis(moved, lowest, axis=-1)[..., 0]
    is_down = (before < FLOOR) & (after < FLOOR)
    return float((moved * is_down).sum() / (STEPS_IN_LAP * laps))


def transitions_a_second(policy: StatePolicy, task: PolicyTask, system: MujocoSystem) -> float:
    """Return how many steps of the physics a policy's bodies go in a second of one core's time, while it walks."""
    motion = task.motion
    assert motion is not None
    stepper = physics_stepper(system, system.scheme, policy.dt)
    rng = np.random.default_rng(0)
    bodies = Bodies(stepper, task.rules, policy.emulator, rng, TIMED_BODIES)
    spent = 0.0
    for _ in range(TIMED_STEPS):
        controls = np.asarray(policy.control_of(jnp.asarray(bodies.states, jnp.float32)), float)
        held = policy.emulator.bounds.clip(controls)
        began = time.process_time()
        system.simulate_fastest(bodies.states, held[:, None], policy.dt, system.scheme)
        spent += time.process_time() - began
        bodies.begin(rng, bodies.step(controls).is_last)
    return TIMED_BODIES * TIMED_STEPS / spent


def draw_sheet(policy: StatePolicy, task: PolicyTask, system: MujocoSystem, out: Path) -> None:
    """Lay pictures of two rounds of the motion on the physics side by side."""
    motion = task.motion
    assert motion is not None
    stepper = physics_stepper(system, system.scheme, policy.dt)
    states = motion_of(policy, stepper, task.rules, 4 * motion.lap, 1)[2 * motion.lap :]
    clip = na.make_clip(policy.emulator, states)
    with TemporaryDirectory() as place:
        tile_motion(clip, Path(place) / "film.mp4", IMAGES, out)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("clips", nargs="*", default=list(UPDATES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--updates", type=int)
    parser.add_argument("--policy", type=Path, help="judge this one instead of learning one")
    parser.add_argument("--keep", type=Path, help="file for the policy")
    parser.add_argument("--sheet", type=Path, help="file for pictures of two rounds")
    arguments = parser.parse_args()
    system = load_system(str(HUMAN / "human.toml"))
    assert isinstance(system, MujocoSystem)
    rows: Rows = []
    curves: Rows = []
    for clip in arguments.clips:
        with TemporaryDirectory() as place:
            row: dict[str, Any] = {"clip": clip, "seed": arguments.seed}
            file = arguments.policy
            if file is None:
                updates = arguments.updates or UPDATES[clip]
                file, seconds, curve = learn(clip, arguments.seed, updates, Path(place))
                row["core seconds"] = seconds
            else:
                curve = curve_of(file, {"clip": clip, "seed": arguments.seed})
            if curve:
                row |= {"transitions": curve[-1]["steps"], "seconds": curve[-1]["seconds"]}
            curves += curve
            policy = load_state_policy(file)
            if arguments.keep:
                policy.save(arguments.keep)
        task = task_of_policy(policy, file, system)
        row |= judged(policy, task, system)
        row["physics, transitions a second"] = transitions_a_second(policy, task, system)
        rows.append(row)
        show_rows([row])
        if arguments.sheet:
            draw_sheet(policy, task, system, arguments.sheet)
        keep_rows(RESULTS / "following.csv", rows, arguments, "clip", "seed")
        keep_rows(RESULTS / "following_curves.csv", curves, arguments, "clip", "seed")


if __name__ == "__main__":
    main()
