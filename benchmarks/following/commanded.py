"""A human on command: errors of speed and turning rate, falls, pushes withstood, and slip of feet.

python -m benchmarks.following.following walk --seed 1 --keep walk.policy.safetensors
python -m benchmarks.following.commanded walk.policy.safetensors
python -m benchmarks.following.commanded walk.policy.safetensors --policy human.policy.safetensors --seeds 0 --dry

Each run calls `neuroanimator policy examples/human/commanded.toml --start walk.policy.safetensors`, which starts from a policy
that follows the walk. Without noise, on the physics,
- 100 bodies get random commands of 0.5 to 1 m/s for 60 s, a new one every 3 to 6 s, and the bodies that never fall are counted; a
  fall is a pelvis below 0.6 m, or a trunk more than 1 rad off the vertical. Another 100 get commands of 0 to 1 m/s, of which
  30 in 100 are to stand;
- from 2 s after a command until its end, its speed and turning rate are compared with the means of the pelvis;
- 100 bodies get one command each for 10 s, and a push of the trunk by 15, 30 or 50 N s in a random horizontal direction, a force
  over 0.1 s; 100 that are commanded to stand are pushed in the same way;
- drift is the median distance of 100 standing bodies between 2 s and 22 s after the command to stand;
- slip is the path of a sole's lowest point while within 5 mm of the floor, per step, at the motion's own speed.
For a policy that also runs, 100 bodies each get commands of all its speeds, of 2 to 3 m/s, and of 3 to 4 m/s; the last two groups
are pushed in the same way, and slip is measured at 2.4 m/s, the recorded speed of the run. And 1,000 bodies each, from random
phases of the motion, are told to walk, to run, or both in turn, with turns, for the 19 s of an episode; those still on the motion
at its end, within 0.25 m and 0.8 rad of it, are counted. Seconds are of one core's time.

Writes commanded.csv and commanded_curves.csv.
"""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

import neuroanimator as na
from benchmarks.following.following import RESULTS, curve_of, slip
from benchmarks.harness import HUMAN, PROGRAM, Clocks, Rows, keep_rows, parser_of, show_rows
from neuroanimator.control.policies.commands import Command, Commands
from neuroanimator.control.policies.reference_motion import ORIENTATION, ReferenceMotion
from neuroanimator.control.policies.state_policy import StatePolicy, load_state_policy
from neuroanimator.gym.bodies import episodes_of
from neuroanimator.gym.following import following_rules
from neuroanimator.gym.policy_task import PolicyTask, follow_table, task_of_policy
from neuroanimator.gym.rules import EpisodeRules
from neuroanimator.gym.state_rows import Stepper, physics_stepper
from neuroanimator.physics import load_system
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.rotation import heading_of
from tools.contact_sheets import tile_motion

UPDATES = 2700
"""Number of updates of the policy, each of 32 steps of `LEARNERS` bodies."""

STAGE = "0 to 4 m/s, from the walk"
"""Name of the learning in the table of curves."""

LEARNERS = 512
"""Number of bodies simulated in parallel during learning."""

BODIES = 100

STARTS = 1000
"""Number of bodies that start at random phases of the motion."""

WALKING = (0.5, 1.0)
"""Minimum and maximum commanded speed [m/s]."""

RUNNING = (2.0, 3.0)

FAST = (3.0, 4.0)

RUN_SPEED = 2.4
"""Recorded speed of the run [m/s]."""

STANDING = (0.0, 0.0)

ANY = (0.0, 1.0)
"""Range of speeds of standing and walking [m/s]."""

STILL_SECONDS = (2.0, 20.0)
"""Time to come to a stand, and time of standing [s]."""

SECONDS = 60.0

HOLDS = (3.0, 6.0)
"""Minimum and maximum time between two commands [s]."""

SETTLED = 2.0
"""Time after a command before errors count [s]: a commanded speed changes at 2 m/s²."""

LEAST_HEIGHT = 0.6
"""Height of the pelvis below which a body has fallen [m]."""

LARGEST_TILT = 1.0
"""Angle of the trunk to the vertical beyond which a body has fallen [rad]."""

IMPULSES = (15.0, 30.0, 50.0)
"""Impulses of pushes [N s]."""

PUSH_STEPS = 13
"""Number of physics steps of a push, 0.0975 s."""

PUSH_SECONDS = 10.0

PUSHED_AT = (2.0, 4.0)
"""Minimum and maximum time of the push [s]."""

IMAGES = 12


def between(commands: Commands, speeds: tuple[float, float]) -> Commands:
    """Return commands of the same turning rates, with a minimum and a maximum speed [m/s]."""
    slowest, fastest = speeds
    least = Command(slowest, commands.least.turning)
    most = Command(fastest, commands.most.turning)
    return commands._replace(least=least, most=most)


class Walkers:
    """Bodies that a policy moves on the physics, or by `stepper`, under commands of a range of speeds, or of all its speeds."""

    def __init__(
        self,
        policy: StatePolicy,
        task: PolicyTask,
        system: MujocoSystem,
        count: int,
        speeds: tuple[float, float] | None = None,
        stepper: Stepper | None = None,
    ):
        reference = policy.view.reference
        assert reference is not None
        assert reference.commands is not None
        assert task.rules.draw_start is not None
        self.policy = policy
        self.system = system
        commands = reference.commands
        self.commands = commands if speeds is None else between(commands, speeds)
        self.reference = reference
        self.rng = np.random.default_rng(0)
        self.stepper = stepper or physics_stepper(system, system.scheme, policy.dt)
        starts = np.stack([task.rules.draw_start(self.rng) for _ in range(count)])
        drawn = jnp.asarray(self.commands.draw(self.rng, starts), jnp.float32)
        self.states = np.asarray(_frames(reference, drawn), float)
        self.told = self.commands_of(self.states)
        """Commands (N, 2): speed [m/s] and turning rate [rad/s]."""
        self.is_fallen = np.zeros(count, bool)
        self.trunk = system.model.body("torso").id

    def commands_of(self, states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, "N 2"]:
        """Return the commands that states carry."""
        return np.stack([self.commands.speed(states), states[:, self.commands.turning]], axis=1)

    def controls(self) -> Float[np.ndarray, "N C"]:
        """Return the controls (N, C) of the policy."""
        return controls_of(self.policy, self.states)

    def step(self) -> None:
        """Take one super step under the commands; fallen bodies stay down."""
        self.states = np.asarray(self.reference.with_command(self.states, self.told))
        # All bodies are set anew: commands are written into the states between two steps.
        moved = self.stepper(self.states, self.controls(), np.ones(len(self.states), bool))
        self._take(moved.states)

    def _take(self, states: Float[np.ndarray, "N S"]) -> None:
        self.is_fallen |= self._falls(states)
        self.states = np.where(self.is_fallen[:, None], self.states, states)

    def _falls(self, states: Float[np.ndarray, "N S"]) -> np.ndarray:
        is_low = states[:, 2] < LEAST_HEIGHT
        return is_low | (self.trunks(states)[:, 2, 2] < np.cos(LARGEST_TILT))

    def trunks(self, states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, "N 3 3"]:
        """Return the rotations of the trunks in these states, from their own axes to the world's."""
        data = mujoco.MjData(self.system.model)
        trunks = []
        for state in states:
            data.qpos[:] = state[: self.system.model.nq]
            mujoco.mj_kinematics(self.system.model, data)
            trunks.append(data.xmat[self.trunk].reshape(3, 3).copy())
        return np.array(trunks)

    def push(self, row: int, impulse: float, angle: float) -> None:
        """Push the trunk of one body for a few physics steps, while its policy goes on controlling it."""
        model = self.system.model
        data = mujoco.MjData(model)
        force = impulse / (PUSH_STEPS * model.opt.timestep)
        left = PUSH_STEPS
        substeps = round(self.policy.dt / model.opt.timestep)
        state = self.states[row]
        while left > 0:
            held = controls_of(self.policy, state[None])
            data.qpos[:] = state[: model.nq]
            data.qvel[:] = state[model.nq : model.nq + model.nv]
            data.ctrl[:] = held[0]
            for _ in range(substeps):
                data.xfrc_applied[self.trunk, :2] = 0
                if left > 0:
                    data.xfrc_applied[self.trunk, :2] = force * np.array(
                        [np.cos(angle), np.sin(angle)]
                    )
                left -= 1
                mujoco.mj_step(model, data)
            state = np.concatenate([data.qpos, data.qvel])
        self.states[row] = state


def controls_of(policy: StatePolicy, states: Float[np.ndarray, "N S"]) -> Float[np.ndarray, "N C"]:
    """Return a policy's controls, within their bounds."""
    found = np.asarray(_controls(policy, jnp.asarray(states, jnp.float32)), float)
    return policy.emulator.bounds.clip(found)


@eqx.filter_jit
def _frames(reference: ReferenceMotion, states: Float[Array, "N S"]) -> Float[Array, "N S"]:
    return reference.frame(states)


@eqx.filter_jit
def _controls(policy: StatePolicy, states: Float[Array, "N S"]) -> Float[Array, "N C"]:
    return policy.control_of(states)


def commanded(walkers: Walkers) -> dict[str, Any]:
    """Return the number of bodies that never fall under random commands, and their median errors."""
    dt = walkers.policy.dt
    count = len(walkers.states)
    commands = walkers.commands
    begun = np.zeros(count)
    ends = np.zeros(count)
    origins = walkers.states.copy()
    errors: list[tuple[float, float]] = []
    headings: list[float] = []
    for step in range(round(SECONDS / dt)):
        now = step * dt
        is_new = now >= ends
        for row in np.flatnonzero(is_new & ~walkers.is_fallen & (ends > 0)):
            before, after = origins[row], walkers.states[row]
            seconds = now - begun[row] - SETTLED
            errors.append(_errors(commands, before, after, seconds))
        drawn = walkers.commands_of(commands.draw(walkers.rng, walkers.states))
        walkers.told = np.where(is_new[:, None], drawn, walkers.told)
        begun = np.where(is_new, now, begun)
        ends = np.where(is_new, now + walkers.rng.uniform(*HOLDS, count), ends)
        is_settled = np.abs(now - begun - SETTLED) < dt / 2
        origins = np.where(is_settled[:, None], walkers.states, origins)
        walkers.step()
        off = heading_of(walkers.states[:, ORIENTATION]) - walkers.states[:, commands.heading]
        headings += list(np.abs((off + np.pi) % (2 * np.pi) - np.pi)[~walkers.is_fallen])
    speeds, turnings = np.array(errors).T
    return {
        "bodies": count,
        "never fell in 60 s": int((~walkers.is_fallen).sum()),
        "speed off m/s": float(np.median(np.abs(speeds))),
        "turning off rad/s": float(np.median(np.abs(turnings))),
        "heading off rad": float(np.median(headings)),
    }


def _errors(
    commands: Commands,
    before: Float[np.ndarray, " S"],
    after: Float[np.ndarray, " S"],
    seconds: float,
) -> tuple[float, float]:
    """Return the errors of speed along the path and of turning rate between two states of a command."""
    speed = float(commands.speed(after))
    turned = after[commands.heading] - before[commands.heading]
    # A path of constant turning rate is an arc: its chord is shorter than the path.
    chord = np.sinc(turned / (2 * np.pi))
    gone = np.linalg.norm(after[:2] - before[:2]) / (chord * seconds)
    heading = heading_of(after[ORIENTATION]) - heading_of(before[ORIENTATION])
    missed = (heading - turned + np.pi) % (2 * np.pi) - np.pi
    return float(gone - speed), float(missed / seconds)


def pushed(walkers: Walkers, impulse: float) -> int:
    """Return the number of bodies that do not fall in 10 s, in which each is pushed once by `impulse` [N s]."""
    dt = walkers.policy.dt
    rng = walkers.rng
    count = len(walkers.states)
    at = np.round(rng.uniform(*PUSHED_AT, count) / dt).astype(int)
    angles = rng.uniform(0, 2 * np.pi, count)
    for step in range(round(PUSH_SECONDS / dt)):
        for row in np.flatnonzero((at == step) & ~walkers.is_fallen):
            walkers.push(int(row), impulse, angles[row])
        walkers.step()
    return int((~walkers.is_fallen).sum())


def drift(walkers: Walkers) -> float:
    """Return the median drift of standing bodies [m]."""
    dt = walkers.policy.dt
    stopped, stood = STILL_SECONDS
    for _ in range(round(stopped / dt)):
        walkers.step()
    before = walkers.states[:, :2].copy()
    for _ in range(round(stood / dt)):
        walkers.step()
    gone = np.linalg.norm(walkers.states[:, :2] - before, axis=1)
    return float(np.median(gone[~walkers.is_fallen]))


def walked(
    policy: StatePolicy,
    task: PolicyTask,
    system: MujocoSystem,
    told: list[tuple[float, float, float]],
    stepper: Stepper | None = None,
) -> Float[np.ndarray, "K S"]:
    """Return the states of one body under commands (seconds, speed [m/s], turning [rad/s]), one after another."""
    first = told[0][1]
    walkers = Walkers(policy, task, system, 1, (first, first), stepper)
    states = []
    for seconds, speed, turning in told:
        walkers.told = np.array([[speed, turning]])
        for _ in range(round(seconds / policy.dt)):
            states.append(walkers.states[0])
            walkers.step()
    return np.array(states)


def judged(policy: StatePolicy, task: PolicyTask, system: MujocoSystem) -> dict[str, Any]:
    """Return the row of results of a policy on the physics."""
    motion = task.motion
    assert motion is not None
    assert motion.commands is not None
    row = {"slowest m/s": motion.commands.least.speed}
    row |= commanded(Walkers(policy, task, system, BODIES, WALKING))
    for impulse in IMPULSES:
        survived = pushed(Walkers(policy, task, system, BODIES, WALKING), impulse)
        row[f"survived {impulse:g} N s"] = survived
    if motion.commands.least.speed == 0:
        found = commanded(Walkers(policy, task, system, BODIES, ANY))
        row["never fell in 60 s from 0 m/s"] = found["never fell in 60 s"]
        row["speed off m/s from 0 m/s"] = found["speed off m/s"]
        for impulse in IMPULSES:
            survived = pushed(Walkers(policy, task, system, BODIES, STANDING), impulse)
            row[f"standing survived {impulse:g} N s"] = survived
        row["drift cm"] = 100 * drift(Walkers(policy, task, system, BODIES, STANDING))
    own = motion.commands.own_speed
    row["slip cm"], row["slip of the clip cm"] = _slips(policy, task, system, motion, own)
    if motion.commands.faster is None:
        return row
    found = commanded(Walkers(policy, task, system, BODIES))
    row |= {f"{name}, all speeds": found[name] for name in found if name != "bodies"}
    for label, speeds in {"running": RUNNING, "fast": FAST}.items():
        if speeds[1] > motion.commands.most.speed:
            continue
        found = commanded(Walkers(policy, task, system, BODIES, speeds))
        row |= {f"{name}, {label}": found[name] for name in found if name != "bodies"}
        for impulse in IMPULSES:
            survived = pushed(Walkers(policy, task, system, BODIES, speeds), impulse)
            row[f"{label} survived {impulse:g} N s"] = survived
    ranges = {"walk": (own, own), "run": (RUN_SPEED, RUN_SPEED), "both": (own, RUN_SPEED)}
    for label, speeds in ranges.items():
        row[f"on the motion of {STARTS}, {label}"] = followed(policy, task, system, speeds)
    slips = _slips(policy, task, system, motion, RUN_SPEED)
    row["slip cm, running"], row["slip of the run's clip cm"] = slips
    return row


def rules_without_pushes(
    policy: StatePolicy, motion: ReferenceMotion, system: MujocoSystem
) -> EpisodeRules:
    """Return the rules of a policy's task, following `motion`, without its pushes."""
    table = follow_table(policy.emulator.definition)
    assert table is not None
    return following_rules(table.model_copy(update={"pushes": None}), motion, system)


def followed(
    policy: StatePolicy, task: PolicyTask, system: MujocoSystem, speeds: tuple[float, float]
) -> int:
    """Return the number of bodies, of `STARTS` that start at random phases, still on the motion after an episode of commands."""
    motion = task.motion
    assert motion is not None
    assert motion.commands is not None
    narrow = replace(motion, commands=between(motion.commands, speeds))
    rules = rules_without_pushes(policy, narrow, system)
    stepper = physics_stepper(system, system.scheme, policy.dt)
    return int((~episodes_of(policy, stepper, rules, STARTS, 0).is_fallen).sum())


def _slips(
    policy: StatePolicy,
    task: PolicyTask,
    system: MujocoSystem,
    motion: ReferenceMotion,
    speed: float,
) -> tuple[float, float]:
    """Return the slip of feet per step at a speed [m/s], and that of the reference motion [cm]."""
    commands = motion.commands
    assert commands is not None
    states = walked(policy, task, system, [(20.0, speed, 0.0)])
    turns = np.tile(motion.begun(0.0), (motion.lap, 1))
    turns[:, motion.phase] = 2 * np.pi * np.arange(motion.lap) / motion.lap
    told = commands.give(turns, np.full(motion.lap, speed), np.zeros(motion.lap))
    frames = np.array(motion.frame(jnp.asarray(told, jnp.float32)), float)
    # Frames stay at the origin: their velocities give the path, at the clock's pace.
    moving = slice(motion.velocity, motion.velocity + 2)
    dt = policy.dt / commands.pace(told)[0]
    frames[:, :2] = np.cumsum(frames[:, moving] * dt, axis=0)
    own_slip = slip(system, frames, 1.0)
    return 100 * slip(system, states, _laps(states, motion.phase)), 100 * own_slip


def _laps(states: Float[np.ndarray, "K S"], phase: int) -> float:
    return float((states[-1, phase] - states[0, phase]) / (2 * np.pi))


def learn(start: Path, seed: int, updates: int, place: Path) -> tuple[Path, float]:
    """Return (the policy's file, core seconds of learning)."""
    for name in ("human.xml", "commanded.xml", "commanded.toml", "walk.csv", "run.csv"):
        (place / name).write_bytes((HUMAN / name).read_bytes())
    shutil.copytree(HUMAN / "skin", place / "skin", dirs_exist_ok=True)
    file = place / "human.policy.safetensors"
    began = Clocks.now()
    command = [PROGRAM, "policy", "commanded.toml", "--start", start.resolve(), "--out", file]
    command += ["--seed", seed, "--updates", updates, "--bodies", LEARNERS]
    subprocess.run([str(part) for part in command], cwd=place, check=True, capture_output=True)
    return file, began.passed().cpu_seconds


def draw_sheet(policy: StatePolicy, states: Float[np.ndarray, "K S"], out: Path) -> None:
    """Write a sheet of pictures of a motion side by side, and its film beside it."""
    clip = na.make_clip(policy.emulator, states)
    tile_motion(clip, out.with_suffix(".mp4"), IMAGES, out)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("start", type=Path, help="policy that follows the walk")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--updates", type=int, default=UPDATES)
    parser.add_argument("--policy", type=Path, help="evaluate this policy instead of learning one")
    parser.add_argument("--keep", type=Path, help="folder for the policies")
    parser.add_argument("--sheet", type=Path, help="file for pictures of commands, with a film")
    arguments = parser.parse_args()
    system = load_system(str(HUMAN / "commanded.toml"))
    assert isinstance(system, MujocoSystem)
    rows: Rows = []
    curves: Rows = []
    for seed in arguments.seeds:
        with TemporaryDirectory() as place:
            row: dict[str, Any] = {"seed": seed}
            file = arguments.policy
            if file is None:
                file, row["core seconds"] = learn(
                    arguments.start, seed, arguments.updates, Path(place)
                )
            curve = curve_of(file, {"seed": seed, "stage": STAGE})
            if curve:
                row |= {"transitions": curve[-1]["steps"]}
            curves += curve
            policy = load_state_policy(file)
            row["file kB"] = file.stat().st_size / 1000
            if arguments.keep:
                policy.save(arguments.keep / f"human-{seed}.policy.safetensors")
        task = task_of_policy(policy, file, system)
        row |= judged(policy, task, system)
        rows.append(row)
        show_rows([row])
        if arguments.sheet:
            told = [(3.0, 0.7, 0.0), (3.0, 0.0, 0.0), (4.0, 0.7, 0.6), (3.0, 0.3, 0.0)]
            draw_sheet(policy, walked(policy, task, system, told), arguments.sheet)
    keep_rows(RESULTS / "commanded.csv", rows, arguments, "seed")
    keep_rows(RESULTS / "commanded_curves.csv", curves, arguments, "seed")


if __name__ == "__main__":
    main()
