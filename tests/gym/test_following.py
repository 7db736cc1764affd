"""Following a motion: who is on it earns all, who is off it loses it, and files that are no motion of the body are refused."""

from __future__ import annotations

from pathlib import Path
from shutil import copytree

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import NeuroAnimatorError, load_system
from neuroanimator.control.policies.reference_motion import ORIENTATION, POSITION, ReferenceMotion
from neuroanimator.definitions.carried import data_identity, read_definition_text
from neuroanimator.definitions.follow import FollowTable
from neuroanimator.gym.following import Following, following_rules
from neuroanimator.gym.policy_task import check_task
from neuroanimator.gym.read_motion import read_motion
from neuroanimator.physics.loading import resolve, trust_files
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.rotation import facing, heading_of, multiply, rotate

HUMAN = Path(__file__).parents[2] / "examples" / "human"

TOML = HUMAN / "human.toml"


@pytest.fixture(scope="module")
def system() -> MujocoSystem:
    system = load_system(str(TOML))
    assert isinstance(system, MujocoSystem)
    return system


@pytest.fixture(scope="module")
def table() -> FollowTable:
    _, definition, _ = resolve(str(TOML))
    table = read_definition_text(definition).definition.follow
    assert table is not None
    return table


@pytest.fixture(scope="module")
def jog(system: MujocoSystem, table: FollowTable) -> ReferenceMotion:
    return read_motion(HUMAN / "jog.csv", table, system)


@pytest.fixture(scope="module")
def following(jog: ReferenceMotion, system: MujocoSystem, table: FollowTable) -> Following:
    return Following.of(jog, system, table)


def test_a_body_on_the_motion_earns_all_and_has_not_lost_it(following: Following):
    frames = following.motion.frames
    np.testing.assert_allclose(eqx.filter_jit(following.reward)(frames), 1, atol=1e-4)
    assert not eqx.filter_jit(following.is_lost)(frames).any()


def test_the_motion_is_lost_where_the_issue_says_so(following: Following):
    frames = following.motion.frames[:3]
    way, tilt = eqx.filter_jit(following.distance), eqx.filter_jit(following.tilt)
    lost = eqx.filter_jit(following.is_lost)
    along = np.array([0.6, 0.8, 0.0])
    for distance, is_lost in ((0.24, False), (0.26, True)):
        moved = frames.at[:, POSITION].add(distance * along)
        np.testing.assert_allclose(way(moved), distance, atol=1e-5)
        assert (lost(moved) == is_lost).all()
    for angle, is_lost in ((0.78, False), (0.82, True)):
        lean = np.array([np.cos(angle / 2), 0, np.sin(angle / 2), 0], np.float32)
        turned = multiply(frames[:, ORIENTATION], jnp.broadcast_to(lean, (3, 4)))
        leaning = frames.at[:, ORIENTATION].set(turned)
        np.testing.assert_allclose(tilt(leaning), angle, atol=1e-3)
        assert (lost(leaning) == is_lost).all()


def test_what_is_farther_off_earns_less(following: Following):
    frame = np.asarray(following.motion.frames[:1])
    frames = np.repeat(frame, 4, axis=0)
    frames[:, following.motion.hinges[3]] += np.array([0, 0.1, 0.3, 1], np.float32)
    earned = eqx.filter_jit(following.reward)(frames).tolist()
    assert earned == sorted(earned, reverse=True)
    assert earned[-1] < 0.8


def test_the_clock_finds_every_frame(jog: ReferenceMotion):
    np.testing.assert_array_equal(jog.index(jog.frames), np.arange(len(jog.frames)))


def test_the_clock_keeps_time_on_the_physics(jog: ReferenceMotion, system: MujocoSystem):
    steps = 40
    controls = np.tile(np.asarray(jog.target(jog.frames[:1])), (1, steps, 1)).astype(float)
    dt = 4 * system.physics_dt
    run = system.simulate(np.asarray(jog.frames[:1], float), controls, dt)
    np.testing.assert_array_equal(jog.index(jnp.asarray(run.states[0])), np.arange(steps + 1))


def test_each_lap_goes_on_as_the_one_before(jog: ReferenceMotion, table: FollowTable):
    frames = np.asarray(jog.frames, float)
    assert len(frames) == table.laps * jog.lap + 1
    first = frames[: jog.lap]
    second = frames[jog.lap : 2 * jog.lap]
    start = frames[jog.lap]
    heading = heading_of(start[ORIENTATION]) - heading_of(frames[0, ORIENTATION])
    assert abs(heading) > 0.3, "the jog turns"
    turn = np.broadcast_to(facing(np.asarray(heading)), (jog.lap, 4))
    origin = frames[0, POSITION] * [1, 1, 0]
    moved = rotate(turn, first[:, POSITION] - origin) + start[POSITION] * [1, 1, 0]
    np.testing.assert_allclose(second[:, POSITION], moved, atol=1e-4)
    np.testing.assert_allclose(second[:, jog.hinges], first[:, jog.hinges], atol=1e-6)


def test_what_is_shown_is_the_same_wherever_the_body_is_and_faces(
    system: MujocoSystem, table: FollowTable
):
    rng = np.random.default_rng(0)
    motion = read_motion(HUMAN / "walk.csv", table, system)
    states = np.asarray(motion.frames[:20], float)
    states += 0.05 * rng.normal(size=states.shape)
    states[:, ORIENTATION] /= np.linalg.norm(states[:, ORIENTATION], axis=1, keepdims=True)
    states[:, motion.phase] = np.asarray(motion.frames[:20, motion.phase])
    frames = np.asarray(motion.frames, float)
    elsewhere = motion.__class__(
        **{**vars(motion), "frames": jnp.asarray(_moved(frames, motion), jnp.float32)}
    )
    np.testing.assert_allclose(
        elsewhere.observe(jnp.asarray(_moved(states, motion), jnp.float32)),
        motion.observe(jnp.asarray(states, jnp.float32)),
        atol=2e-4,
    )


def _moved(states: np.ndarray, motion: ReferenceMotion) -> np.ndarray:
    turn = np.broadcast_to(facing(np.asarray(1.1)), (len(states), 4))
    velocity = slice(motion.velocity, motion.velocity + 3)
    states = states.copy()
    states[:, POSITION] = rotate(turn, states[:, POSITION]) + np.array([3.0, -2.0, 0.0])
    states[:, ORIENTATION] = multiply(turn, states[:, ORIENTATION])
    states[:, velocity] = rotate(turn, states[:, velocity])
    return states


def test_servos_come_to_the_next_pose(jog: ReferenceMotion, system: MujocoSystem):
    # Without a lead they lag behind by their damping over their stiffness.
    frames = np.asarray(jog.frames[:20], float)
    dt = 4 * system.physics_dt
    aims = np.asarray(jog.target(jog.frames[:20]), float)
    plain = np.asarray(jog.frames[1:21], float)[:, jog.driven]

    def off(controls: np.ndarray) -> float:
        after = system.simulate(frames, controls[:, None], dt).states[:, 1]
        wanted = np.asarray(jog.frames[1:21], float)
        return float(np.abs(after - wanted)[:, jog.driven].mean())

    assert off(aims) < 0.7 * off(plain)


def test_episodes_begin_on_the_motion_and_end_with_it(
    jog: ReferenceMotion, system: MujocoSystem, table: FollowTable
):
    rules = following_rules(table, jog, system)
    assert rules.draw_start is not None
    assert rules.steps is not None
    rng = np.random.default_rng(0)
    starts = np.array([rules.draw_start(rng) for _ in range(50)])
    begins = np.asarray(jog.index(jnp.asarray(starts)))
    assert begins.max() + rules.steps <= len(jog.frames) - 1
    assert len(set(begins.tolist())) > 15
    assert not rules.is_over(starts).any()
    ends = rules.is_cut(np.asarray(jog.frames[-2:], float))
    np.testing.assert_array_equal(ends, [False, True])


def changed(tmp_path: Path, change) -> Path:
    """Return the file of the walk after `change` of its cells, the header's first."""
    rows = [line.split(",") for line in (HUMAN / "walk.csv").read_text().splitlines()]
    change(rows)
    path = tmp_path / "walk.csv"
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    return path


def set_cell(rows: list[list[str]], row: int, column: int, cell: str) -> None:
    rows[row][column] = cell


def swap_joints(rows: list[list[str]]) -> None:
    for row in rows:
        row[8], row[9] = row[9], row[8]


def slower(rows: list[list[str]]) -> None:
    for number, row in enumerate(rows[1:]):
        row[0] = f"{number / 30:.5f}"


WRONG = {
    "joints in another order": (swap_joints, "column 9: wanted 'hip_x_right.* its joints in this"),
    "another body": (lambda rows: [row.pop() for row in rows], "column 62: wanted .*, got ''"),
    "another rate": (slower, "line 3: 0.0333333 s after the row before; wanted 0.03 s"),
    "a quaternion that is none": (
        lambda rows: set_cell(rows, 5, 4, "0.5"),
        "line 6: the root's quaternion has length",
    ),
    "no number": (
        lambda rows: set_cell(rows, 7, 12, "nan"),
        r"line 8, column 13 .*: wanted a finite number",
    ),
    "a clock that stands": (
        lambda rows: set_cell(rows, 9, 31, "0.1"),
        "line 10: 'phase' is 0.1; wanted",
    ),
    "an open loop": (
        lambda rows: set_cell(rows, -1, 11, "1.5"),
        "its last pose is not its first: 'knee_right",
    ),
    "one state": (lambda rows: rows.__delitem__(slice(2, None)), "two states or more"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_motion_of_the_body_is_refused_with_the_fix(
    name: str, tmp_path: Path, system: MujocoSystem, table: FollowTable
):
    change, message = WRONG[name]
    with pytest.raises(NeuroAnimatorError, match=message):
        read_motion(changed(tmp_path, change), table, system)


def test_bodies_that_cannot_follow_are_refused(system: MujocoSystem, table: FollowTable):
    with pytest.raises(NeuroAnimatorError, match="no servo of a joint"):
        read_motion(HUMAN / "walk.csv", table, load_system("pendulum"))
    with pytest.raises(NeuroAnimatorError, match="no hinge called 'clock'. Hinges: hip_x_right"):
        read_motion(HUMAN / "walk.csv", table.model_copy(update={"phase": "clock"}), system)
    motion = read_motion(HUMAN / "walk.csv", table, system)
    with pytest.raises(NeuroAnimatorError, match="no part called 'chest'. Parts: .*torso"):
        Following.of(motion, system, table.model_copy(update={"trunk": "chest"}))
    with pytest.raises(NeuroAnimatorError, match="states in all; wanted at most"):
        read_motion(HUMAN / "walk.csv", table.model_copy(update={"laps": 1000}), system)


def test_a_file_with_two_tasks_is_refused(tmp_path: Path):
    copytree(HUMAN, tmp_path, dirs_exist_ok=True)
    toml = tmp_path / "human.toml"
    toml.write_text(TOML.read_text() + "\n[task]\nhold = 4\n")
    _, definition, _ = resolve(str(toml))
    trust_files(toml)
    with pytest.raises(NeuroAnimatorError, match="does one or the other"):
        check_task(definition, "human.toml")


def test_what_is_followed_is_no_physics(tmp_path: Path):
    copytree(HUMAN, tmp_path, dirs_exist_ok=True)
    toml = tmp_path / "human.toml"
    whole = TOML.read_text()
    texts = []
    for text in (whole, whole.replace("walk.csv", "jog.csv"), whole[: whole.index("[follow]")]):
        toml.write_text(text)
        texts.append(resolve(str(toml))[1])
    assert len(set(texts)) == 3
    assert len({data_identity(text) for text in texts}) == 1
