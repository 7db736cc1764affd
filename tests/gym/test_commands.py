"""Walking on command: the motion goes as fast and the way it is told, and a policy begins with what another can do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from soft_bodies import hasty_emulator

from neuroanimator import Emulator, NeuroAnimatorError, Pilot, load_system
from neuroanimator.cli.policy_returns import commanded_motion
from neuroanimator.cli.train import train_in_policy
from neuroanimator.control.policies.commands import (
    MAX_CHANGE,
    SLOW_SHARE,
    STANDING_SHARE,
    Commands,
)
from neuroanimator.control.policies.reference_motion import (
    ACCELERATION,
    ORIENTATION,
    POSITION,
    WALKING_LEAD,
    ReferenceMotion,
)
from neuroanimator.control.policies.state_policy import StatePolicy, load_state_policy
from neuroanimator.definitions.follow import CommandsTable, FollowTable
from neuroanimator.export.programs.formats import export_programs
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.gym.bodies import Bodies
from neuroanimator.gym.disturbances import pushed
from neuroanimator.gym.following import Following
from neuroanimator.gym.gaits import SHARES
from neuroanimator.gym.learner import CRITIC_FIRST, Learner
from neuroanimator.gym.policy_task import FOLLOWING, PolicyTask, follow_table, task_to_learn
from neuroanimator.gym.policy_transitions import policy_transitions
from neuroanimator.gym.state_rows import physics_stepper
from neuroanimator.physics.loading import trust_files
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.rotation import facing, heading_of, multiply, rotate, rotation_between

TOML = Path(__file__).parents[2] / "examples" / "human" / "commanded.toml"

SMALL = replace(FOLLOWING, bodies=16, horizon=3, policy_widths=(8,), critic_widths=(8,))


@pytest.fixture(scope="module")
def system() -> MujocoSystem:
    system = load_system(str(TOML))
    assert isinstance(system, MujocoSystem)
    return system


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Emulator:
    trust_files(TOML)
    return hasty_emulator(TOML, tmp_path_factory.mktemp("commanded"), 4)


@pytest.fixture(scope="module")
def table(emulator: Emulator) -> FollowTable:
    table = follow_table(emulator.definition)
    assert table is not None
    return table


@pytest.fixture(scope="module")
def task(system: MujocoSystem, emulator: Emulator) -> PolicyTask:
    return task_to_learn(emulator.definition, TOML, system)


@pytest.fixture(scope="module")
def motion(task: PolicyTask) -> ReferenceMotion:
    assert task.motion is not None
    return task.motion


@pytest.fixture(scope="module")
def commands(motion: ReferenceMotion) -> Commands:
    assert motion.commands is not None
    return motion.commands


@pytest.fixture(scope="module")
def policy(system: MujocoSystem, emulator: Emulator, task: PolicyTask) -> StatePolicy:
    learner = Learner(system, emulator, task.rules, SMALL, task.motion)
    learner.advance()
    return learner.policy


@pytest.fixture(scope="module")
def starts(task: PolicyTask) -> np.ndarray:
    assert task.rules.draw_start is not None
    rng = np.random.default_rng(0)
    return np.stack([task.rules.draw_start(rng) for _ in range(20)])


def test_the_motion_comes_round(motion: ReferenceMotion, starts: np.ndarray):
    later = starts.copy()
    later[:, motion.phase] += 6 * np.pi
    kept = [*range(7), *motion.hinges, *motion.rates]
    np.testing.assert_allclose(
        _frame(motion, later)[:, kept], _frame(motion, starts)[:, kept], atol=2e-3
    )


def test_the_frame_of_a_moment_later_is_where_clock_and_heading_will_be(
    motion: ReferenceMotion, commands: Commands, starts: np.ndarray, emulator: Emulator
):
    later = starts.copy()
    later[:, motion.phase] += emulator.dt * starts[:, commands.clock_rate]
    later[:, commands.heading] += emulator.dt * starts[:, commands.turning]
    found = np.asarray(motion.frame(jnp.asarray(starts, jnp.float32), 1))
    kept = [*range(7), *motion.hinges, *motion.rates]
    np.testing.assert_allclose(found[:, kept], _frame(motion, later)[:, kept], atol=1e-3)


def test_it_moves_and_turns_as_fast_as_its_velocities_say(
    motion: ReferenceMotion, commands: Commands, starts: np.ndarray, emulator: Emulator
):
    now = _frame(motion, starts)
    dt = emulator.dt / 2
    before, after = starts.copy(), starts.copy()
    for states, time in ((before, -dt), (after, dt)):
        states[:, motion.phase] += time * starts[:, commands.clock_rate]
        states[:, commands.heading] += time * starts[:, commands.turning]
    first, last = _frame(motion, before), _frame(motion, after)
    rates = (last - first)[:, motion.hinges] / (2 * dt)
    assert np.abs(rates - now[:, motion.rates]).mean() < 0.1
    spin = rotation_between(first[:, ORIENTATION], last[:, ORIENTATION]) / (2 * dt)
    spinning = slice(motion.velocity + 3, motion.velocity + 6)
    assert np.abs(spin - now[:, spinning]).max() < 0.15


def test_a_body_told_nothing_else_goes_as_fast_as_the_motion_was_recorded(
    motion: ReferenceMotion, commands: Commands
):
    states = np.stack([motion.begun(phase) for phase in np.linspace(0, 2 * np.pi, 54)[:-1]])
    velocity = states[:, motion.velocity]
    np.testing.assert_allclose(velocity.mean(), commands.own_speed, rtol=0.01)
    np.testing.assert_allclose(commands.own_speed, 1.09331 / 1.59, rtol=0.02)
    fastest = commands.give(states, np.full(53, 9.0), np.zeros(53))
    np.testing.assert_allclose(commands.speed(fastest), commands.most.speed, rtol=1e-6)


@pytest.mark.parametrize("runs", [False, True])
def test_strides_are_as_long_as_the_commanded_speed_needs(
    runs: bool, motion: ReferenceMotion, commands: Commands
):
    assert commands.faster is not None
    if not runs:
        walking = replace(motion, frames=motion.frames[: -commands.faster.laps * motion.lap])
        commands = commands._replace(faster=None)
        motion = replace(walking, commands=commands)
    speeds = np.linspace(0, 4, 41)
    told = commands.give(np.tile(motion.begun(0.0), (41, 1)), speeds, np.full(41, 0.8))
    np.testing.assert_allclose(commands.speed(told), speeds, atol=1e-5)
    strides = commands.stride(told)
    assert strides[0] == 0
    assert (np.diff(strides) >= -1e-6).all()
    longest = commands.faster.stride if commands.faster else 1
    np.testing.assert_allclose(strides[speeds > 3.6], longest)
    for speed in speeds[::5]:
        states = np.stack([motion.begun(phase) for phase in np.linspace(0, 2 * np.pi, 54)[:-1]])
        frames = _frame(motion, commands.give(states, np.full(53, speed), np.zeros(53)))
        np.testing.assert_allclose(frames[:, motion.velocity].mean(), speed, atol=0.01)


def test_at_its_own_speed_the_run_is_the_clip(
    motion: ReferenceMotion, commands: Commands, system: MujocoSystem
):
    recorded = np.loadtxt(TOML.parent / "run.csv", delimiter=",", skiprows=1)[:-1, 1:]
    velocity = motion.velocity - 1  # a clip has no commanded heading
    own = np.linalg.norm(recorded[:, velocity : velocity + 2].mean(axis=0))
    assert own == pytest.approx(2.374, abs=0.01)
    assert commands.speed(motion.frames[:1]).shape == (1,)
    assert commands.faster is not None
    pace, stride, _ = commands.faster
    share = 1 / SHARES[-1]
    on_line = (1 + share * (pace - 1)) * (1 + share * (stride - 1))
    assert commands.own_speed * on_line == pytest.approx(own, abs=0.01)
    base = np.tile(motion.begun(0.0), (len(recorded), 1))
    base[:, motion.phase] = 2 * np.pi * np.arange(len(recorded)) / len(recorded)
    frames = _frame(motion, commands.give(base, np.full(len(base), own), np.zeros(len(base))))
    hinges = list(motion.hinges)
    apart = [
        np.abs(np.roll(frames[:, hinges], shift, axis=0) - recorded[:, hinges]).max()
        for shift in range(len(base))
    ]
    assert min(apart) < 0.15
    spread = np.ptp(recorded[:, hinges], axis=0).max()
    assert max(apart) > 0.5 * spread, "begun elsewhere it is another pose"


def test_a_command_is_three_numbers_of_a_state_and_comes_true_as_fast_as_a_body_can_follow(
    motion: ReferenceMotion, commands: Commands, starts: np.ndarray
):
    command = np.stack([np.linspace(-1, 5, 20), np.linspace(-2, 2, 20)], axis=1)
    starts = starts.copy()
    starts[:, commands.heading] = np.linspace(-9, 9, 20)
    told = motion.with_command(starts, command)
    changed = np.flatnonzero((told != starts).any(axis=0))
    assert set(changed) == {commands.heading, commands.turning, commands.clock_rate}
    lead = told[:, commands.heading] - heading_of(told[:, ORIENTATION])
    assert np.abs(lead).max() <= WALKING_LEAD + 1e-9
    sooner = np.abs(commands.speed(told) - commands.speed(starts))
    np.testing.assert_array_less(sooner, ACCELERATION * motion.dt + 1e-9)
    in_jax = motion.with_command(*(jnp.asarray(one, jnp.float32) for one in (starts, command)))
    np.testing.assert_allclose(in_jax, told, atol=1e-4)
    for _ in range(round(4.0 / (ACCELERATION * motion.dt))):
        told = motion.with_command(told, command)
    np.testing.assert_allclose(commands.speed(told), np.clip(command[:, 0], 0, 4), atol=1e-6)
    np.testing.assert_allclose(motion.with_command(told, command), told, atol=1e-12)


def test_who_is_told_to_stand_stands_as_the_model_does_at_rest(
    motion: ReferenceMotion, commands: Commands, system: MujocoSystem, starts: np.ndarray
):
    told = commands.give(starts, np.zeros(len(starts)), np.full(len(starts), 0.8))
    frames = _frame(motion, told)
    assert (told[:, commands.turning] == 0).all()
    hinges = list(motion.hinges)
    np.testing.assert_allclose(frames[:, hinges], np.tile(system.rest[hinges], (20, 1)), atol=1e-4)
    np.testing.assert_allclose(frames[:, motion.rates], 0, atol=1e-4)
    moving = slice(motion.velocity, motion.velocity + 6)
    np.testing.assert_allclose(frames[:, moving], 0, atol=1e-4)


@pytest.mark.parametrize("speed", [0.2, 0.45, 0.8, 2.4, 4.0])
def test_feet_of_other_strides_stand_on_the_floor(
    speed: float,
    motion: ReferenceMotion,
    commands: Commands,
    system: MujocoSystem,
    table: FollowTable,
    emulator: Emulator,
):
    following = Following.of(motion, system, table)
    states = np.stack([motion.begun(phase) for phase in np.linspace(0, 2 * np.pi, 54)[:-1]])
    told = jnp.asarray(commands.give(states, np.full(53, speed), np.zeros(53)), jnp.float32)
    frame = eqx.filter_jit(motion.frame)
    now = frame(told)
    later = frame(told, 1)
    later = later.at[:, 0].add(emulator.dt * now[:, motion.velocity])
    sliding = eqx.filter_jit(following.sliding)(now, later, emulator.dt)
    assert float(sliding.mean()) < 0.3 * speed


def test_on_the_motion_all_is_earned_at_every_command_and_wherever_the_body_is(
    motion: ReferenceMotion, system: MujocoSystem, table: FollowTable, starts: np.ndarray
):
    following = Following.of(motion, system, table)
    reward, is_lost = eqx.filter_jit(following.reward), eqx.filter_jit(following.is_lost)
    frames = _frame(motion, starts)
    elsewhere = frames.copy()
    elsewhere[:, :2] += 7.0
    for states in (frames, elsewhere):
        np.testing.assert_allclose(reward(states), 1, atol=1e-4)
        assert not is_lost(states).any()
    higher, lower = frames.copy(), frames.copy()
    higher[:, POSITION.stop - 1] += 0.1
    lower[:, 2] -= 0.26
    assert (reward(higher) < 0.9).all()
    assert is_lost(lower).all()


def test_feet_that_slide_earn_less_and_feet_in_the_air_do_not_slide(
    motion: ReferenceMotion,
    commands: Commands,
    system: MujocoSystem,
    table: FollowTable,
    starts: np.ndarray,
):
    following = Following.of(motion, system, table)
    walking = commands.give(starts, np.linspace(0, 0.7, 20), np.zeros(20))
    states = _frame(motion, walking)
    moved = states.copy()
    moved[:, 0] += 0.03
    lifted, gone = states.copy(), moved.copy()
    lifted[:, 2] += 0.3
    gone[:, 2] += 0.3
    sliding = eqx.filter_jit(following.sliding)
    np.testing.assert_allclose(sliding(states, states, 0.03), 0, atol=1e-5)
    assert (sliding(states, moved, 0.03) > 0.1).all()
    np.testing.assert_allclose(sliding(lifted, gone, 0.03), 0, atol=1e-3)


def test_what_is_shown_is_the_same_whichever_way_it_is_told_to_go(
    motion: ReferenceMotion, commands: Commands, starts: np.ndarray
):
    turn = np.broadcast_to(facing(np.asarray(1.1)), (len(starts), 4))
    velocity = slice(motion.velocity, motion.velocity + 3)
    turned = starts.copy()
    turned[:, POSITION] = rotate(turn, starts[:, POSITION]) + np.array([3.0, -2.0, 0.0])
    turned[:, ORIENTATION] = multiply(turn, starts[:, ORIENTATION])
    turned[:, velocity] = rotate(turn, starts[:, velocity])
    turned[:, commands.heading] += 1.1
    np.testing.assert_allclose(
        motion.observe(jnp.asarray(turned, jnp.float32)),
        motion.observe(jnp.asarray(starts, jnp.float32)),
        atol=2e-4,
    )


def test_commands_change_in_an_episode_and_bodies_are_pushed(
    policy: StatePolicy, system: MujocoSystem, task: PolicyTask, commands: Commands
):
    rng = np.random.default_rng(0)
    stepper = physics_stepper(system, system.scheme, policy.dt)
    bodies = Bodies(stepper, task.rules, policy.emulator, rng, 300)
    before = bodies.states.copy()
    bodies.begin(rng, np.zeros(300, bool))
    is_told = (before != bodies.states)[:, commands.turning]
    is_pushed = (before != bodies.states)[:, -30]
    assert 0 < is_told.sum() < 20
    assert 0 < is_pushed.sum() < 20
    np.testing.assert_array_equal(before[:, :32], bodies.states[:, :32])


def test_a_push_gives_the_body_its_impulse(system: MujocoSystem, starts: np.ndarray):
    model = system.model
    data = mujoco.MjData(model)
    after = pushed(model, "torso", starts[:4], np.full(4, 50.0), np.random.default_rng(0))
    for first, last in zip(starts, after, strict=False):
        momenta = []
        for state in (first, last):
            data.qpos[:] = state[: model.nq]
            data.qvel[:] = state[model.nq :]
            mujoco.mj_forward(model, data)
            mujoco.mj_subtreeVel(model, data)
            pelvis = model.body("pelvis").id
            momenta.append(data.subtree_linvel[pelvis] * model.body_subtreemass[pelvis])
        gained = momenta[1] - momenta[0]
        np.testing.assert_allclose(np.linalg.norm(gained[:2]), 50, rtol=1e-6)
        np.testing.assert_allclose(gained[2], 0, atol=1e-6)


def test_learning_begins_with_what_a_policy_can_do(
    policy: StatePolicy, system: MujocoSystem, emulator: Emulator, task: PolicyTask
):
    learner = Learner(system, emulator, task.rules, SMALL, task.motion, policy)
    assert task.motion is not None
    states = task.motion.frame(jnp.asarray(learner.bodies.states, jnp.float32))
    np.testing.assert_allclose(
        learner.policy.control_of(states), policy.control_of(states), atol=1e-3
    )


def test_with_a_longer_reach_it_begins_with_the_same_controls(
    policy: StatePolicy, system: MujocoSystem, emulator: Emulator, task: PolicyTask
):
    motion = task.motion
    assert motion is not None
    longer = replace(motion, reach=2 * motion.reach)
    learner = Learner(system, emulator, task.rules, SMALL, longer, policy)
    states = motion.frame(jnp.asarray(learner.bodies.states, jnp.float32))
    np.testing.assert_allclose(
        learner.policy.control_of(states), policy.control_of(states), atol=2e-3
    )


def test_a_policy_that_learning_begins_with_is_kept_until_the_critic_knows_it(
    policy: StatePolicy, system: MujocoSystem, emulator: Emulator, task: PolicyTask
):
    learner = Learner(system, emulator, task.rules, SMALL, task.motion, policy)
    before = learner.progress
    learner.advance()
    after = learner.progress
    np.testing.assert_array_equal(after.actor.network.weights[0], before.actor.network.weights[0])
    assert (after.critic.network.weights[0] != before.critic.network.weights[0]).any()
    learner.counters = learner.counters._replace(update=CRITIC_FIRST)
    learner.advance()
    moved = learner.progress.actor.network.weights[0]
    assert (moved != before.actor.network.weights[0]).any()


@pytest.mark.parametrize("ending", [".h", ".onnx"])
def test_programs_do_what_jax_does(ending: str, policy: StatePolicy, tmp_path: Path):
    file = tmp_path / "human.policy.safetensors"
    policy.save(file)
    (written,) = export_programs(str(file), [tmp_path / f"human{ending}"], is_policy=False)
    assert written.difference < 1e-3


DAMAGE = {
    "heading": 63,
    "turning": -1,
    "own_rate": 0,
    "speed": [1.0],
    "turning_rate": ["a", 1],
    "standing_pace": 1,
    "faster": {"pace": 1.0, "stride": 2.0, "laps": 2},
}


@pytest.mark.parametrize("key", DAMAGE)
def test_damaged_commands_are_refused(key: str, policy: StatePolicy, tmp_path: Path):
    path = tmp_path / "human.policy.safetensors"
    policy.save(path)
    tensors, metadata = read_tensors(path, "state-policy")
    reference = metadata["reference"]
    told = reference["commands"] | {key: DAMAGE[key]}
    changed = metadata | {"reference": reference | {"commands": told}}
    write_tensors(path, tensors, changed)
    with pytest.raises(NeuroAnimatorError, match="not a usable policy"):
        load_state_policy(path)


def test_ranges_with_the_larger_number_first_are_refused():
    with pytest.raises(ValueError, match="wanted the least first"):
        CommandsTable(speed=(1.0, 0.5), turning=(-1, 1))


def test_a_pilot_tells_the_body_how_fast_and_which_way(
    policy: StatePolicy, system: MujocoSystem, commands: Commands
):
    pilot = Pilot(policy, system)
    frame = pilot.reset(phase=1.0)
    assert frame.state[commands.clock_rate] == pytest.approx(commands.own_rate)
    for _ in range(6):
        frame = pilot.step(speed=0.5, turn=0.4, dt=0.015)
    assert frame.state[commands.heading] == pytest.approx(0.4 * 0.09, abs=1e-5)
    assert frame.pose.position[0] > 0.02
    assert pilot.top_speed == 4.0
    assert len(pilot.controls) == 23
    turned = frame.state.copy()
    turned[commands.heading] = 2.0
    led = pilot.step(speed=0.5, dt=policy.dt, state=turned)
    lead = led.state[commands.heading] - heading_of(turned[ORIENTATION])
    assert lead == pytest.approx(WALKING_LEAD, abs=1e-5)


def test_without_a_system_a_pilot_moves_the_emulator(policy: StatePolicy, commands: Commands):
    pilot = Pilot(policy)
    start = pilot.reset(phase=1.0).state
    told = commands.give(start, np.asarray(0.6), np.asarray(0.0))
    after = pilot.step(speed=0.6, dt=policy.dt).state
    expected = policy.emulator.step(told, pilot.controls)
    np.testing.assert_allclose(after, expected, atol=1e-4)


def test_a_pilot_says_what_it_needs(policy: StatePolicy, system: MujocoSystem):
    with pytest.raises(NeuroAnimatorError, match="Leave it out"):
        Pilot("fish", system)
    with pytest.raises(NeuroAnimatorError, match="wanted the body of the policy"):
        Pilot(policy, load_system("pendulum"))
    with pytest.raises(NeuroAnimatorError, match="walks on the ground"):
        Pilot(policy, system).step(speed=0.5, climb=0.2)


def test_commands_are_told_one_after_another(
    policy: StatePolicy, commands: Commands, tmp_path: Path
):
    file = tmp_path / "human.policy.safetensors"
    policy.save(file)
    _, states = commanded_motion(file, TOML, ["0.09,0.6,0.2", "0.06,0.9,-0.4"])
    assert len(states) == 6
    assert states[-1, commands.heading] == pytest.approx(0.2 * 0.09 - 0.4 * 0.06, abs=1e-5)
    step = ACCELERATION * policy.dt
    speeds = [commands.own_speed - step, 0.6, 0.6, 0.6 + step, 0.6 + 2 * step]
    np.testing.assert_allclose(commands.speed(states[1:]), speeds, atol=1e-3)
    for text in ("3", "3,0.7,left", "-1,0.7,0"):
        with pytest.raises(NeuroAnimatorError, match="command: wanted"):
            commanded_motion(file, TOML, [text])


def test_while_a_policy_learns_half_of_the_commands_are_slow_and_none_jumps(
    motion: ReferenceMotion, commands: Commands
):
    states = np.tile(np.asarray(motion.frames, float)[0], (4000, 1))
    own = commands.own_speed
    for speed in (0.0, 0.3, own, own + 0.9, own + 1.1):
        now = commands.give(states, np.full(len(states), speed), np.zeros(len(states)))
        drawn = commands.speed(commands.draw_change(np.random.default_rng(2), now))
        assert np.abs(drawn - speed).max() <= MAX_CHANGE + 1e-9
        low, high = max(speed - MAX_CHANGE, 0), min(speed + MAX_CHANGE, 3)
        slow_of_the_rest = np.clip((own - low) / (high - low), 0, 1)
        can_stand = STANDING_SHARE if low == 0 else 0.0
        slow = SLOW_SHARE + (1 - SLOW_SHARE) * slow_of_the_rest if low < own else 0.0
        slow = can_stand + (1 - can_stand) * slow
        assert np.mean(drawn <= own + 1e-9) == pytest.approx(slow, abs=0.03)


def test_what_a_policy_does_is_learnt_as_the_physics_has_it(
    policy: StatePolicy, task: PolicyTask, system: MujocoSystem, commands: Commands
):
    data = policy_transitions(policy, task, system, count=4_000, seed=1)
    again = policy_transitions(policy, task, system, count=4_000, seed=1)
    assert data.fingerprint == again.fingerprint
    assert 400 < len(data.states) <= 200 * 17
    told = [commands.clock_rate, commands.turning]
    np.testing.assert_array_equal(np.ptp(data.states[:, :, told], axis=1), 0)
    chosen = data.where(slice(0, 40))
    stepper = physics_stepper(system, system.scheme, policy.dt)
    for step in range(data.controls.shape[1]):
        moved = stepper(chosen.states[:, step], chosen.controls[:, step], np.ones(40, bool))
        np.testing.assert_allclose(moved.states, chosen.states[:, step + 1], atol=2e-2)


@pytest.mark.endurance
def test_train_puts_the_emulator_into_the_policys_file(
    policy: StatePolicy, tmp_path: Path, starts: np.ndarray
):
    file = tmp_path / "human.policy.safetensors"
    policy.save(file)
    out = tmp_path / "trained.policy.safetensors"
    settings = {"updates": 250, "widths": (8,), "unroll_share": 0.0}
    train_in_policy(file, out, settings, count=4_000)
    trained = load_state_policy(out)
    rows = jnp.asarray(starts, jnp.float32)
    np.testing.assert_array_equal(trained.control_of(rows), policy.control_of(rows))
    known = trained.emulator.validation
    assert known is not None
    assert known.emulator < known.no_change
    with pytest.raises(NeuroAnimatorError, match="wanted a name that ends in"):
        train_in_policy(file, tmp_path / "human.safetensors", settings)


def _frame(motion: ReferenceMotion, states: np.ndarray) -> np.ndarray:
    return np.asarray(eqx.filter_jit(motion.frame)(jnp.asarray(states, jnp.float32)))
