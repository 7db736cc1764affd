"""Policies that follow a motion: learnt the same again from where a run was killed, kept in files, and programs like others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import Cli
from soft_bodies import hasty_emulator

from neuroanimator import Emulator, NeuroAnimatorError, load_system
from neuroanimator.control.policies.state_policy import StatePolicy, load_state_policy
from neuroanimator.export.csv_file import read_table
from neuroanimator.export.programs.formats import export_programs
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.gym.bodies import episodes_of
from neuroanimator.gym.learn_policy import learn_policy
from neuroanimator.gym.learner import Learner
from neuroanimator.gym.policy_task import FOLLOWING, PolicyTask, task_of_policy, task_to_learn
from neuroanimator.gym.state_rows import physics_stepper
from neuroanimator.physics.loading import trust_files
from neuroanimator.systems.system import System

TOML = Path(__file__).parents[2] / "examples" / "human" / "human.toml"

SMALL = replace(
    FOLLOWING,
    updates=2,
    bodies=16,
    horizon=3,
    policy_widths=(8,),
    critic_widths=(8,),
    reports=2,
)


@pytest.fixture(scope="module")
def system() -> System:
    return load_system(str(TOML))


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Emulator:
    trust_files(TOML)
    return hasty_emulator(TOML, tmp_path_factory.mktemp("human"), 4)


@pytest.fixture(scope="module")
def task(system: System, emulator: Emulator) -> PolicyTask:
    return task_to_learn(emulator.definition, TOML, system)


@pytest.fixture(scope="module")
def policy(system: System, emulator: Emulator, task: PolicyTask) -> StatePolicy:
    learner = Learner(system, emulator, task.rules, SMALL, task.motion)
    learner.advance()
    return learner.policy


def interrupt(report: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.endurance  # tests/gym/test_policy_gradient.py kills the same learner without a motion to follow
def test_a_run_that_was_killed_ends_with_the_same_bytes(
    system: System, emulator: Emulator, task: PolicyTask, tmp_path: Path
):
    def learn(
        name: str, task: PolicyTask, on_report: Callable[[object], None] = lambda report: None
    ) -> StatePolicy:
        return learn_policy(
            system, emulator, task.rules, SMALL,
            reference=task.motion, folder=tmp_path / name, on_report=on_report,
        )  # fmt: skip

    learn("whole", task).save(tmp_path / "whole.policy.safetensors")
    with pytest.raises(KeyboardInterrupt):
        learn("killed", task, interrupt)
    learn("killed", task).save(tmp_path / "killed.policy.safetensors")
    first = (tmp_path / "whole.policy.safetensors").read_bytes()
    assert first == (tmp_path / "killed.policy.safetensors").read_bytes()
    with pytest.raises(NeuroAnimatorError, match="other data or settings"):
        learn("whole", replace_frames(task))


def replace_frames(task: PolicyTask) -> PolicyTask:
    """Return the task with another motion."""
    motion = task.motion
    assert motion is not None
    changed = {**vars(motion), "frames": motion.frames + 0.01}
    return task._replace(motion=motion.__class__(**changed))


def test_a_file_keeps_the_policy_and_its_motion(
    policy: StatePolicy, system: System, task: PolicyTask, tmp_path: Path
):
    path = tmp_path / "walk.policy.safetensors"
    policy.save(path)
    read = load_state_policy(path)
    assert task.motion is not None
    states = task.motion.frames[3:9] + 0.01
    np.testing.assert_array_equal(read.control_of(states), policy.control_of(states))
    again = task_of_policy(read, path, system)
    assert again.motion is not None
    np.testing.assert_array_equal(again.motion.frames, task.motion.frames)
    stepper = physics_stepper(system, system.scheme, policy.dt)
    first = episodes_of(policy, stepper, task.rules, 2, 0)
    second = episodes_of(read, stepper, again.rules, 2, 0)
    np.testing.assert_array_equal(first.returns, second.returns)
    assert first.is_fallen.all(), "nobody walks after one update"


def test_controls_stay_within_reach_of_the_motion_and_within_bounds(
    policy: StatePolicy, task: PolicyTask
):
    motion = task.motion
    assert motion is not None
    states = motion.frames[:30]
    noise = jnp.asarray(np.random.default_rng(0).normal(size=(30, 23)), jnp.float32)
    controls = np.asarray(eqx.filter_jit(policy.control_of)(states, 10 * noise))
    bounds = policy.emulator.bounds
    assert (controls >= np.array(bounds.low, np.float32)).all()
    assert (controls <= np.array(bounds.high, np.float32)).all()
    aims = np.asarray(eqx.filter_jit(motion.target)(states))
    assert np.abs(controls - aims).max() < motion.reach + 1e-5


@pytest.mark.parametrize("ending", [".h", ".onnx"])
def test_programs_do_what_jax_does(ending: str, policy: StatePolicy, tmp_path: Path):
    file = tmp_path / "walk.policy.safetensors"
    policy.save(file)
    (written,) = export_programs(str(file), [tmp_path / f"walk{ending}"], is_policy=False)
    assert written.difference < 1e-3


DAMAGE = {
    "frames": 0,
    "lap": 0,
    "phase": 61,
    "velocity": 56,
    "hinges": [7, 90],
    "driven": [7],
    "leads": [-1.0] * 23,
    "reach": -1,
}


@pytest.mark.parametrize("key", DAMAGE)
def test_a_damaged_motion_is_refused(key: str, policy: StatePolicy, tmp_path: Path):
    path = tmp_path / "walk.policy.safetensors"
    policy.save(path)
    tensors, metadata = read_tensors(path, "state-policy")
    reference = metadata["reference"] | {key: DAMAGE[key]}
    write_tensors(path, tensors, metadata | {"reference": reference})
    with pytest.raises(NeuroAnimatorError, match="not a usable policy"):
        load_state_policy(path)


def test_a_human_from_its_toml_to_its_motion(emulator: Emulator, cli: Cli, tmp_path: Path):
    def told(*arguments: str) -> str:
        done = cli(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return done.stdout

    emulator.save(tmp_path / "leaps.emulator.safetensors")
    file = "walk.policy.safetensors"
    learn = ("policy", str(TOML), "--emulator", "leaps.emulator.safetensors", "--out", file)
    assert "512" in told(*learn, "--updates", "1", "--bodies", "16")
    evaluated = ("evaluate", file, "--system", str(TOML), "--episodes", "3")
    assert '"on_the_motion_at_its_end": 0' in told(*evaluated, "--json")
    assert "0 of them at its end" in told(*evaluated)
    told("animate", file, "--system", str(TOML), "--seconds", "0.3", "--out", "walk.glb")
    assert (tmp_path / "walk.glb").stat().st_size > 1000


@pytest.mark.parametrize(
    "place",
    [
        pytest.param((), id="on the physics"),
        pytest.param(("--in-emulator",), id="inside", marks=pytest.mark.endurance),
    ],
)
def test_the_policy_that_ships_gets_up_from_the_floor(
    system: System, cli: Cli, tmp_path: Path, place: tuple[str, ...]
):
    toml = TOML.with_name("get-up.toml")
    policy = TOML.with_name("get-up.policy.safetensors")
    out = tmp_path / "up.csv"
    done = cli("animate", str(policy), "--system", str(toml), *place, "--out", str(out))
    assert done.returncode == 0, done.stderr
    _, states = read_table(out, system.state)
    height = states[:, 2]
    assert height[0] < 0.2
    assert height[-1] > 0.8
