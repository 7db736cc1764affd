"""Rules of episodes: a task declared in TOML or Python is the environment's own, in an emulator and on the physics."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from neuroanimator import DatasetConfig, Emulator, NeuroAnimatorError, TrainingConfig
from neuroanimator.control.planning.environments import mujoco_state
from neuroanimator.data.generate import simulate_transitions
from neuroanimator.gym import EmulatorVectorEnv, EpisodeRules, PhysicsVectorEnv, mjcf_of
from neuroanimator.gym.rules_table import find_rules
from neuroanimator.gym.same_step import SameStepRows
from neuroanimator.systems.loading import resolve
from neuroanimator.training.initialise import build_emulator

STEPS = 60

DEFINITIONS = {
    "Swimmer-v5": (
        0.01,
        {
            "slider1": "cyclic",
            "slider2": "cyclic",
            "free_body_rot": "sine",
            "motor1_rot": "plain",
            "motor2_rot": "plain",
        },
    ),
    "Hopper-v5": (
        0.002,
        {
            "rootx": "cyclic",
            "rootz": "plain",
            "rooty": "sine",
            "thigh_joint": "plain",
            "leg_joint": "plain",
            "foot_joint": "plain",
        },
    ),
}
"""Physics step [s] and kinds of joints; `neuroanimator new` writes more, and takes longer."""

TABLE = """
steps = 20

[reward]
forward = { part = "angle", entry = 1, weight = 2.0 }
control_cost = 0.01
healthy = 0.5

[healthy]
angle = [-1.0, inf]

[observation]
leave_out = ["angle"]
clip_velocities = 0.1

[start]
parts = { velocity = [0.1, 0.2, 0.3] }
noise = 0.05
"""


@pytest.fixture(scope="module", params=list(DEFINITIONS))
def task(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """(id, untrained emulator) of an environment of Gymnasium's; a super step is a step of it."""
    step, joints = DEFINITIONS[request.param]
    name = request.param.split("-")[0].lower()
    folder = tmp_path_factory.mktemp(name)
    lines = [f'name = "{name}"', 'kind = "mujoco"', f'model = "{name}.xml"', "[physics]"]
    lines += [f"step = {step}", f"truth_step = {step}", f"fine_step = {step / 10}"]
    lines += [f'{scheme}integrator = "rk4"' for scheme in ("", "truth_", "fine_")]
    lines += ["[state]", *[f'{joint} = "{kind}"' for joint, kind in joints.items()]]
    (folder / f"{name}.xml").write_bytes(mjcf_of(request.param).read_bytes())
    toml = folder / f"{name}.toml"
    toml.write_text("\n".join(lines))
    system, definition, _ = resolve(str(toml))
    config = DatasetConfig(system=system, definition=definition, substeps=4, count=360)
    emulator = build_emulator(simulate_transitions(config), TrainingConfig(widths=(8, 8)))
    return request.param, emulator


@pytest.fixture
def table(tmp_path: Path) -> Callable[..., Path]:
    """Write `TABLE` with some of its text exchanged."""

    def write(*exchanged: tuple[str, str]) -> Path:
        text = TABLE
        for old, new in exchanged:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "task.toml"
        path.write_text(text)
        return path

    return write


def played(env_id: str, seed: int) -> list[tuple[Any, ...]]:
    """Return (state, action, state after it, observation, reward, terminated) of steps of the environment itself."""
    env = gymnasium.make(env_id)
    env.reset(seed=seed)
    env.action_space.seed(seed)
    rows = []
    is_over = False
    while not is_over and len(rows) < STEPS:
        before = mujoco_state(env, None)
        action = env.action_space.sample()
        observation, reward, terminated, is_over, _ = env.step(action)
        is_over = is_over or terminated
        rows.append((before, action, mujoco_state(env, None), observation, reward, terminated))
    env.close()
    return rows


def test_the_table_of_an_environment_pays_shows_and_ends_what_the_environment_does(task: Any):
    env_id, emulator = task
    rules = find_rules(env_id, emulator)
    rows = [row for seed in range(4) for row in played(env_id, seed)]
    states, actions, following, observations, rewards, terminated = map(
        np.array, zip(*rows, strict=True)
    )
    paid = rules.reward(states, actions, following, emulator.dt)
    np.testing.assert_allclose(paid, rewards, atol=1e-9)
    np.testing.assert_array_equal(rules.observe(following), observations)
    np.testing.assert_array_equal(rules.is_over(following), terminated)
    assert terminated.any() == (env_id == "Hopper-v5")
    assert np.ptp(rewards) > 0.1


def test_on_the_physics_the_rules_are_the_environment(task: Any):
    env_id, emulator = task
    rows = played(env_id, 3)
    env = PhysicsVectorEnv(emulator, rules=env_id)
    env.reset(options={"state": rows[0][0]})
    for _, action, following, observation, reward, terminated in rows:
        shown, paid, is_over, _, _ = env.step(action[None])
        np.testing.assert_allclose(env.shown_states()[0], following, atol=1e-6)
        np.testing.assert_allclose(shown[0], observation, atol=1e-5)
        assert paid[0] == pytest.approx(reward, abs=1e-6)
        assert is_over[0] == terminated


def test_starts_are_drawn_as_the_environment_draws_them(task: Any):
    env_id, emulator = task
    rules = find_rules(env_id, emulator)
    random = np.random.default_rng(0)
    drawn = np.stack([rules.draw_start(random) for _ in range(400)])
    env = gymnasium.make(env_id)
    theirs = []
    for seed in range(400):
        env.reset(seed=seed)
        theirs.append(mujoco_state(env, None))
    env.close()
    reach = np.ptp(theirs, axis=0)
    np.testing.assert_allclose(drawn.mean(axis=0), np.mean(theirs, axis=0), atol=0.1 * reach.max())
    np.testing.assert_allclose(np.ptp(drawn, axis=0), reach, rtol=0.05)


def test_an_emulator_with_rules_has_the_spaces_of_the_environment(task: Any):
    env_id, emulator = task
    ours = EmulatorVectorEnv(emulator, 3, rules=env_id)
    theirs = gymnasium.make(env_id)
    assert ours.single_observation_space.shape == theirs.observation_space.shape
    assert ours.single_action_space == theirs.action_space
    assert ours.steps == theirs.spec.max_episode_steps
    theirs.close()


def test_a_table_says_what_a_function_says(shipped: Emulator, table: Callable[..., Path]):
    def reward(states, controls, following, dt):
        speed = (following[:, 1] - states[:, 1]) / dt
        return 2 * speed - 0.01 * (controls**2).sum(axis=1) + 0.5 * (following[:, :3] > -1).all(1)

    def is_over(states):
        return ~(states[:, :3] > -1).all(axis=1)

    rules = EpisodeRules(
        reward, lambda states: np.clip(states[:, 3:], -0.1, 0.1), is_over, steps=20
    )
    start = np.array([0.1, 0.2, -0.9, 1.0, 2.0, -3.0])
    declared = EmulatorVectorEnv(shipped, 2, rules=table())
    written = EmulatorVectorEnv(shipped, 2, rules=rules)
    firsts = [env.reset(options={"state": start})[0] for env in (declared, written)]
    np.testing.assert_array_equal(*firsts)
    action = np.array([[5.0, 1.0, -2.0], [-20.0, 0.0, 9.0]])
    has_ended = np.zeros(2, bool)
    while not has_ended.any():
        one, other = (env.step(action) for env in (declared, written))
        for ours, theirs in zip(one[:4], other[:4], strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)
        has_ended = one[2] | one[3]
    assert one[2].any()
    start_of_table = declared.reset(seed=1)[0]
    assert (np.abs(start_of_table) <= 0.1).all()
    velocities = declared.shown_states()[:, 3:]
    assert (np.abs(velocities - [0.1, 0.2, 0.3]) <= 0.05).all()


@pytest.mark.parametrize(
    ("exchanged", "message"),
    [
        (("entry = 1", "entry = 3"), "task.toml: reward.forward: 'angle' has 3 numbers.*came 3"),
        (('part = "angle"', 'part = "angel"'), "task.toml: No part called 'angel'. Parts: angle"),
        (("[-1.0, inf]", "[1.0, -1.0]"), "healthy.angle: wanted the least value below the largest"),
        (("control_cost", "effort"), "task.toml: reward.effort: extra inputs"),
        (("steps = 20", "steps = 0"), "task.toml: steps"),
        (("noise = 0.05", "noise = nan"), "task.toml: start.noise"),
        (('["angle"]', '["angle", "velocity"]'), "observation.leave_out: nothing is left"),
        (("[0.1, 0.2, 0.3]", "[0.1]"), "start: 'velocity' has 3 numbers"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(
    shipped: Emulator, table: Callable[..., Path], exchanged: tuple[str, str], message: str
):
    with pytest.raises(NeuroAnimatorError, match=message):
        EmulatorVectorEnv(shipped, rules=table(exchanged))


def test_rules_that_do_not_exist_are_answered_with_those_that_do(shipped: Emulator):
    with pytest.raises(NeuroAnimatorError, match="No rules called 'Swimer-v5'.*Swimmer-v5"):
        EmulatorVectorEnv(shipped, rules="Swimer-v5")
    with pytest.raises(NeuroAnimatorError, match="reward and rules: both came. Give one"):
        EmulatorVectorEnv(shipped, rules="Swimmer-v5", reward=max)


def test_a_step_beyond_the_trust_limit_ends_the_episode_and_no_other_does(shipped: Emulator):
    fast = np.array([0, 0, 0, 1.1 * float(shipped.domain.high[0]), 0, 0])
    still = np.zeros(6)
    for limit in (1.0, np.inf):
        env = EmulatorVectorEnv(shipped, 2, trust_limit=limit)
        env.reset(options={"state": np.stack([fast, still])})
        _, _, terminated, _, info = env.step(np.zeros((2, 3)))
        assert info["trust"][0] > 1 > info["trust"][1]
        assert terminated.tolist() == [limit == 1.0, False]


def test_the_penalty_is_in_proportion_to_how_far_a_step_is_beyond_the_edge(shipped: Emulator):
    fast = np.array([0, 0, 0, 1.1 * float(shipped.domain.high[0]), 0, 0])
    states = np.stack([fast, np.zeros(6)])
    earned = []
    for penalty in (0.0, 0.5):
        env = EmulatorVectorEnv(shipped, 2, trust_penalty=penalty)
        env.reset(options={"state": states})
        _, rewards, _, _, info = env.step(np.zeros((2, 3)))
        earned.append(rewards)
    lost = earned[0] - earned[1]
    assert lost[0] == pytest.approx(0.5 * (info["trust"][0] - 1), rel=1e-4)
    assert lost[1] == 0


@pytest.mark.parametrize("choice", [{"trust_limit": 0.0}, {"trust_penalty": -1.0}])
def test_a_guard_that_makes_no_sense_is_refused(shipped: Emulator, choice: dict[str, float]):
    with pytest.raises(NeuroAnimatorError, match="trust_limit and trust_penalty: wanted"):
        EmulatorVectorEnv(shipped, **choice)


def test_on_the_physics_and_in_its_emulator_episodes_begin_alike_and_stay_close(shipped: Emulator):
    actions = np.random.default_rng(0).uniform(-5, 5, (10, 3, 3))
    ends = []
    for kind in (EmulatorVectorEnv, PhysicsVectorEnv):
        env = kind(shipped, 3)
        first, _ = env.reset(seed=4)
        states = [env.step(action)[0] for action in actions]
        ends.append((first, states))
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    assert np.abs(np.array(ends[0][1]) - ends[1][1]).max() < 0.1 * np.ptp(ends[1][1])


def test_rows_that_end_start_anew_in_the_same_step_and_say_what_they_came_to(shipped: Emulator):
    rows = SameStepRows(EmulatorVectorEnv(shipped, 2, seconds=3 * shipped.dt))
    plain = EmulatorVectorEnv(shipped, 2, seconds=3 * shipped.dt)
    first = rows.reset(seed=7)
    np.testing.assert_array_equal(first, plain.reset(seed=7)[0])
    action = np.full((2, 3), 0.5, np.float32)
    control = 0.5 * np.array(shipped.bounds.high)
    earned = np.zeros(2)
    for step in range(3):
        stepped = rows.step(action)
        observations, rewards, *_ = plain.step(np.tile(control, (2, 1)))
        earned += rewards
        np.testing.assert_allclose(stepped.rewards, rewards, rtol=1e-6)
        assert stepped.has_ended.all() == (step == 2)
    for row, info in enumerate(stepped.infos):
        np.testing.assert_array_equal(info["terminal_observation"], observations[row])
        assert info["TimeLimit.truncated"]
        assert info["episode"] == {"r": pytest.approx(earned[row]), "l": 3}
        assert info["trust"] < 1
    following, *_ = plain.step(np.tile(control, (2, 1)))
    np.testing.assert_array_equal(stepped.observations, following)
    assert rows.step(action).infos == [{}, {}]


def test_without_stable_baselines3_one_line_says_how_to_install_it():
    code = "import sys; sys.modules['stable_baselines3'] = None; import neuroanimator.gym.stable_baselines"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    last = run.stderr.strip().splitlines()[-1]
    assert last.endswith(
        "stable-baselines3 is missing. Install it with: pip install 'neuroanimator[rl]'"
    )


def test_stable_baselines3_learns_in_an_emulator(shipped: Emulator):
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is missing: an extra, [rl]")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from neuroanimator.gym.stable_baselines import StableBaselinesEnv

    env = VecNormalize(StableBaselinesEnv(EmulatorVectorEnv(shipped, 16, seconds=0.5)))
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=128, n_epochs=1, seed=0, device="cpu")
    model.learn(512)
    assert model.num_timesteps == 512
    assert len(model.ep_info_buffer) > 10
