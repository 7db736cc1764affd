"""A human who walks on command inside his emulator: falls and returns beside those on MuJoCo, and the cost of a step.

python -m benchmarks.following.emulated_walk  the policy in examples/human
python -m benchmarks.following.emulated_walk human.policy.safetensors --sheet walk.png --dry

`neuroanimator train examples/human/human.policy.safetensors` makes the policy's emulator. The same policy moves bodies on MuJoCo,
at the step it learnt with and at a quarter of it, and in the emulator:
- 100 bodies under random commands of all its speeds for 60 s, as in commanded.py: number that never fall, and errors of speed and
  turning rate;
- returns of 1,000 episodes of the task, with pushes (up to 60 N s every 2 s in the mean) and without, of 636 at most, and number
  still on the motion at their end;
- errors of the emulator against the physics after 1, 8, 16 and 32 super steps from states of a walk, under the same controls;
- time of a super step on one core: MuJoCo's four steps by `mujoco.rollout`, from states of a walk; the emulator in C; policy
  and emulator together in C.

Writes emulated_walk.csv, emulated_walk_errors.csv and emulated_walk_speed.csv.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from benchmarks.following.commanded import (
    BODIES,
    Walkers,
    commanded,
    draw_sheet,
    rules_without_pushes,
    walked,
)
from benchmarks.following.following import RESULTS
from benchmarks.harness import HUMAN, Rows, keep_rows, parser_of, show_rows
from neuroanimator.cli.policy_returns import loaded_policy
from neuroanimator.control.policies.state_policy import StatePolicy
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.emulator.c_rows import RowFunction
from neuroanimator.emulator.tensors import to_numpy
from neuroanimator.files.atomic import digest
from neuroanimator.gym.bodies import episodes_of
from neuroanimator.gym.policy_task import PolicyTask
from neuroanimator.gym.state_rows import EmulatorStepper, Stepper, physics_stepper
from neuroanimator.learn.evaluation.speed import (
    IN_C,
    TIMED_SUPER_STEPS,
    emulator_players,
    interleaved,
    one_core,
)
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.rotation import rotation_between

EPISODES = 1000

FINE = 4
"""Number of fine physics steps in one of those that the policy learnt with."""

LOOK_AHEAD = (1, 8, 16, 32)
"""Number of super steps after which errors are measured."""

PIECES = 40
"""Number of stretches of a walk, of `LOOK_AHEAD[-1]` super steps, that MuJoCo is timed on."""

SETTLING = 100
"""Number of super steps before states of a walk are taken."""

COPIES = 25
"""Number of times that these states are side by side where policy and emulator are timed."""


def compared(policy: StatePolicy, task: PolicyTask, system: MujocoSystem) -> Rows:
    """Return what the policy does on the physics and in its emulator, a row each."""
    fine = replace(system.scheme, dt=system.scheme.dt / FINE)
    steppers: dict[str, Stepper] = {
        "MuJoCo": physics_stepper(system, system.scheme, policy.dt),
        "emulator": EmulatorStepper(policy.emulator, np.inf, 0.0),
        "MuJoCo, fine": physics_stepper(system, fine, policy.dt),
    }
    return [
        {"in": name} | outcome(policy, task, system, stepper) for name, stepper in steppers.items()
    ]


def outcome(
    policy: StatePolicy, task: PolicyTask, system: MujocoSystem, stepper: Stepper
) -> dict[str, Any]:
    """Return what the policy does with bodies that `stepper` moves."""
    assert task.motion is not None
    calm = rules_without_pushes(policy, task.motion, system)
    row = commanded(Walkers(policy, task, system, BODIES, stepper=stepper))
    for label, rules in {"": calm, " with pushes": task.rules}.items():
        found = episodes_of(policy, stepper, rules, EPISODES, 0)
        row["return" + label] = float(found.returns.mean())
        row["on the motion" + label] = int((~found.is_fallen).sum())
    return row


def walk(
    policy: StatePolicy, task: PolicyTask, system: MujocoSystem
) -> tuple[Float[np.ndarray, "B S"], Float[np.ndarray, "T B C"], Float[np.ndarray, "T B S"]]:
    """Return (states, controls of the policy from there on, states under them) of bodies that walk on the physics."""
    walkers = Walkers(policy, task, system, PIECES)
    for _ in range(SETTLING):
        walkers.step()
    starts = walkers.states
    controls = []
    states = []
    for _ in range(LOOK_AHEAD[-1]):
        controls.append(walkers.controls())
        walkers.step()
        states.append(walkers.states)
    return starts, np.stack(controls), np.stack(states)


def errors(policy: StatePolicy, task: PolicyTask, system: MujocoSystem) -> Rows:
    """Return root mean square errors of the emulator after some super steps, and how far bodies moved beside them."""
    starts, controls, states = walk(policy, task, system)
    assert task.motion is not None
    hinges = np.array(task.motion.hinges)
    emulated = [
        policy.emulator.rollout(start, driven)
        for start, driven in zip(starts, np.swapaxes(controls, 0, 1), strict=True)
    ]
    rows = []
    for steps in LOOK_AHEAD:
        found = np.array([path[steps] for path in emulated], float)
        truth = states[steps - 1]
        turned = rotation_between(truth[:, 3:7], found[:, 3:7])
        rows.append(
            {
                "super steps": steps,
                "seconds": steps * policy.dt,
                "root mm": 1000 * _root_mean_square(found[:, :3] - truth[:, :3]),
                "root moved mm": 1000 * _root_mean_square(truth[:, :3] - starts[:, :3]),
                "trunk rad": _root_mean_square(turned),
                "joints rad": float(np.sqrt(np.mean((found - truth)[:, hinges] ** 2))),
            }
        )
    return rows


def _root_mean_square(vectors: Float[np.ndarray, "B 3"]) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def speed(policy: StatePolicy, task: PolicyTask, system: MujocoSystem) -> dict[str, Any]:
    """Return the time of a super step [µs], on one core."""
    starts, controls, _ = walk(policy, task, system)
    driven = np.ascontiguousarray(np.swapaxes(controls, 0, 1))
    states = as_float32(np.tile(starts, (COPIES, 1)))
    rows = RowFunction(
        walking_step,
        lambda policy: [digest(to_numpy(policy.leaves()))],
        lambda policy: [states],
    )
    in_c = rows.in_c(policy)
    if in_c is None:
        raise SystemExit("There is no C compiler.")
    simulate = partial(system.simulate, starts, driven, policy.dt, scheme=system.scheme, threads=1)
    players = {"physics": simulate, "walking": partial(in_c, states)}
    with one_core():
        players["emulator"] = emulator_players(policy.emulator)[IN_C]
        seconds = interleaved(players)
    physics = 1e6 * seconds["physics"] / (PIECES * LOOK_AHEAD[-1])
    emulator = 1e6 * seconds["emulator"] / TIMED_SUPER_STEPS
    return {
        "MuJoCo µs": physics,
        "emulator µs": emulator,
        "factor": physics / emulator,
        "policy and emulator µs": 1e6 * seconds["walking"] / len(states),
    }


def walking_step(
    policy: StatePolicy, state: Float[Array, " S"]
) -> tuple[Float[Array, " S"], Float[Array, " C"]]:
    """Return (the state a super step later, the controls held on the way), of one body."""
    controls = policy.control_of(state)
    return policy.emulator.step_latent(state, controls), controls


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("policy", type=Path, nargs="?", default=HUMAN / "human.policy.safetensors")
    parser.add_argument("--only", choices=("compared", "errors", "speed"), help="a part of it")
    parser.add_argument("--sheet", type=Path, help="file for pictures of commands, with a film")
    arguments = parser.parse_args()
    policy, system, task = loaded_policy(arguments.policy, HUMAN / "commanded.toml")
    assert isinstance(system, MujocoSystem)
    parts = {
        "compared": ("emulated_walk.csv", lambda: compared(policy, task, system)),
        "errors": ("emulated_walk_errors.csv", lambda: errors(policy, task, system)),
        "speed": ("emulated_walk_speed.csv", lambda: [speed(policy, task, system)]),
    }
    for name, (file, measure) in parts.items():
        if arguments.only not in (None, name):
            continue
        rows = measure()
        show_rows(rows)
        keep_rows(RESULTS / file, rows, arguments)
    if arguments.sheet:
        told = [(3.0, 0.7, 0.0), (4.0, 0.7, 0.6), (3.0, 0.9, 0.0), (3.0, 0.5, -0.6)]
        stepper = EmulatorStepper(policy.emulator, np.inf, 0.0)
        draw_sheet(policy, walked(policy, task, system, told, stepper), arguments.sheet)


if __name__ == "__main__":
    main()
