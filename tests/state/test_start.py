"""Where motions start: named parts of the state, the same in TOML and on the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Cli

from neuroanimator import Emulator, load_emulator, load_system, read_pose
from neuroanimator.animation.motion import named_start
from neuroanimator.control.objective.goals import goal_start, is_reached
from neuroanimator.definitions.parts import GoalTable
from neuroanimator.errors import ArgumentError
from neuroanimator.state.start import read_starts


@pytest.mark.parametrize(
    ("system", "goal"), [("lander", "pad"), ("pendulum", "upright"), ("truck", "bay_3")]
)
def test_no_goal_is_fulfilled_where_it_starts(system: str, goal: str):
    made = load_system(system)
    assert not is_reached(made, goal, goal_start(made, goal))


def test_the_lander_starts_over_its_pad_and_is_there_at_rest():
    lander = load_system("lander")
    start = goal_start(lander, "pad")
    np.testing.assert_array_equal(start[:3], [3, -2, 8])
    assert is_reached(lander, "pad", lander.rest)


def test_a_start_is_read_as_it_is_typed():
    assert read_starts(["root.position=3,-2,8", " root.heading = 1.5 "]) == {
        "root.position": (3.0, -2.0, 8.0),
        "root.heading": (1.5,),
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("root.position", "wanted NAME=NUMBERS such as root.position=3,-2,8"),
        ("root.position=a,b,c", "'root.position': wanted numbers separated by commas"),
        ("root.position=", "wanted numbers separated by commas"),
        ("root.position=1,2", "'root.position' has 3 numbers [m], got 2"),
        ("root.position=1,2,nan", "'root.position': wanted finite numbers"),
        (
            "root.plce=1,2,3",
            "no part called 'root.plce'. Parts, how many numbers and their unit: root.position (3, m)",
        ),
        ("root.orientation=0,0,0,0", "a quaternion of zeros is no rotation"),
    ],
)
def test_a_start_that_makes_no_sense_is_refused_by_name(text: str, message: str):
    with pytest.raises(ArgumentError) as caught:
        load_system("lander").start_at(read_starts([text]))
    assert message in str(caught.value)


def test_field_words_name_the_same_parts():
    lander = load_system("lander")
    ours = lander.start_at({"root.position": (1, 2, 9), "root.orientation": (0, 0, 0, 2)})
    theirs = lander.start_at({"root.position": (1, 2, 9), "root.orientation": (0, 0, 0, 1)})
    np.testing.assert_array_equal(ours, theirs)


def test_system_and_emulator_give_the_same_start():
    lander, emulator = load_system("lander"), load_emulator("lander")
    parts = {
        "root.position": (1.0, 2.0, 9.0),
        "root.heading": (0.5,),
        "root.velocity": (0.0, 0.1, -0.2),
    }
    np.testing.assert_allclose(named_start(emulator, parts), lander.start_at(parts), atol=1e-12)


def test_a_swimmer_is_moved_and_turned_as_a_whole():
    emulator = Emulator.load("fish")
    fish = load_system("fish")
    parts = {
        "body.position": (1.0, 2.0, -0.5),
        "body.heading": (np.pi / 2,),
        "body.velocity": (0.0, 0.1, 0.0),
    }
    start = named_start(emulator, parts)
    pose = read_pose(fish.structure, start)
    np.testing.assert_allclose(pose.position, [1, 2, -0.5], atol=1e-9)
    np.testing.assert_allclose(pose.forward, [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(pose.velocity, [0, 0.1, 0], atol=1e-9)
    at_rest, moved = (np.reshape(state[:69], (23, 3)) for state in (fish.rest, start))
    lengths = [np.linalg.norm(points[:, None] - points, axis=-1) for points in (at_rest, moved)]
    np.testing.assert_allclose(*lengths, atol=1e-9)


def test_a_goals_start_is_checked_with_its_system():
    lander = load_system("lander")
    with pytest.raises(ArgumentError, match="goals.pad: start: no part called 'wing'"):
        lander.goals_of({"pad": GoalTable(start={"wing": (1.0,)})})


def test_control_says_already_there_and_writes_nothing(cli: Cli, tmp_path: Path):
    out = tmp_path / "c.csv"
    done = cli(
        "control", "lander", "--goal", "pad", "--start", "root.position=0,0,1.9529", "--out", out
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Nothing to find, so nothing was written: lander")
    assert "reached" not in done.stdout
    assert not out.exists()


def test_animate_starts_where_it_is_told(cli: Cli, tmp_path: Path):
    out = tmp_path / "m.csv"
    done = cli(
        "animate", "lander", "--start", "root.position=3,-2,8", "--seconds", "0.5", "--out", out
    )
    assert done.returncode == 0, done.stderr
    first = out.read_text().splitlines()[1].split(",")
    assert [float(number) for number in first[1:4]] == pytest.approx([3, -2, 8])
    wrong = cli("animate", "lander", "--start", "wing=3", "--out", out)
    assert wrong.returncode == 2
    assert "no part called 'wing'" in wrong.stderr
