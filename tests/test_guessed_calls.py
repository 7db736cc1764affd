"""What somebody guesses works, or says in one line what to do instead."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from waiting import PATIENCE

import neuroanimator as na
from neuroanimator.control.objective.costs import follow_path
from neuroanimator.state.rotation import facing

GUESSES = """
import warnings
import neuroanimator as na
fish, pendulum = na.load_system("fish"), na.load_system("pendulum")
emulator = na.load_emulator("pendulum-50")
cost = na.effort()
find = lambda **length: na.synthesise(emulator, pendulum, na.Objective.of(cost), pendulum.rest, **length)
GUESSES = [
    lambda: na.Objective(cost),
    lambda: na.Objective(cost, cost),
    lambda: find(steps=1.5),
    lambda: find(),
    lambda: find(steps=3, seconds=1.0),
    lambda: na.write_glb(emulator, "a.glb"),
    lambda: na.load_emulator("fihs"),
    lambda: na.load_policy("dolfin"),
    lambda: na.load_system("pendulm"),
    lambda: na.goal(pendulum, "uprigth"),
    lambda: pendulum.start_at({"root.headin": 1}),
    lambda: na.reach_point(pendulum, "lowr", [0, 0, 1], within=0.1),
    lambda: fish.start_at({"body.heading": "left"}),
    lambda: na.evaluate("fihs"),
    lambda: na.synthesise(emulator, pendulum, "upright", pendulum.rest, steps=3),
    lambda: find(steps=3, corrections=8),
    lambda: find(steps=3, minutes=3.0),
    lambda: find(steps=3, options=3),
    lambda: na.control.synthesise_goal(emulator, pendulum, "upright", goals_from=pendulum),
    lambda: na.synthesise(emulator, emulator, na.goal(pendulum, "upright"), pendulum.rest, steps=3),
]
for guess in GUESSES:
    try:
        guess()
    except na.NeuroAnimatorError as error:
        print(str(error).replace("\\n", "|"))
"""
"""In a process of its own: here every call is held against its annotations, which users' calls are not."""

ANSWERS = (
    "Objective.of(effort(), ...) takes costs one by one.",
    "Objective.of(effort(), ...) takes costs one by one.",
    "steps: wanted a whole number of super steps, at least 1; got 1.5.",
    "steps and seconds: wanted one of them, the length of the motion.",
    "steps and seconds: wanted one of them, the length of the motion.",
    "clips: wanted Clip, as make_clip returns, got Emulator.",
    "none of that name ships. Did you mean fish?",
    "none of that name ships. Did you mean dolphin?",
    "Did you mean pendulum?",
    "Did you mean upright?",
    "no part called 'root.headin'.",
    "Did you mean lower?",
    "start: 'body.heading': wanted a number or several, got 'left'.",
    "none of that name ships. Did you mean fish?",
    "objective: wanted Objective, as Objective.of returns, got the text 'upright'.",
    "corrections: write options=na.SearchOptions(corrections=...).",
    "minutes: write options=na.SearchOptions(refine=na.Refinement(minutes=...)).",
    "options: wanted SearchOptions, got int.",
    "goals_from: write the system, with its goals, as the second argument.",
    "system: wanted System, as load_system returns, got Emulator.",
)


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        timeout=PATIENCE,
    )


def test_what_cannot_be_meant_is_answered_in_one_line():
    done = python(GUESSES)
    told = done.stdout.splitlines()
    assert len(told) == len(ANSWERS), done.stdout + done.stderr
    for line, answer in zip(told, ANSWERS, strict=True):
        assert answer in line


def test_gymnasium_makes_an_environment_by_the_name_of_its_system_alone():
    code = (
        "import gymnasium\n"
        "env = gymnasium.make('neuroanimator.gym:neuroanimator/fish-v0')\n"
        "print(env.observation_space.shape)"
    )
    done = python(code)
    assert done.stdout.startswith("("), done.stderr


def test_a_graphics_library_that_cannot_draw_here_is_named(tmp_path: Path):
    code = (
        "import numpy as np, neuroanimator as na\n"
        "fish = na.load_emulator('fish')\n"
        "clip = na.make_clip(fish, np.stack([fish.rest] * 3))\n"
        f"na.write_video(clip, {str(tmp_path / 'a.mp4')!r}, size=(64, 64))"
    )
    done = python(code, MUJOCO_GL="glfw", DISPLAY="", WAYLAND_DISPLAY="")
    assert "MUJOCO_GL=glfw asks to draw with glfw alone" in done.stderr
    assert "it needs a display" in done.stderr


def test_a_start_may_be_said_as_on_the_command_line_and_by_a_number_alone():
    truck = na.load_system("truck")
    turned = truck.start_at({"root.heading": 0.6})
    np.testing.assert_allclose(
        turned[truck.state.index("root.orientation")], facing(np.float64(0.6))
    )
    np.testing.assert_array_equal(truck.start_at("root.heading=0.6"), turned)
    both = truck.start_at(["root.heading=0.6", "root.position=3,-2,1"])
    np.testing.assert_array_equal(
        both, truck.start_at({"root.heading": 0.6, "root.position": [3, -2, 1]})
    )


def test_a_path_says_itself_how_far_off_is_far():
    truck = na.load_system("truck")
    term = follow_path(truck, [[0, 0], [3, 4]], axes="xy")
    assert float(term.within) == pytest.approx(0.5)


def test_a_motion_may_be_as_long_as_so_many_seconds(shipped: na.Emulator):
    pendulum = na.load_system("pendulum")
    options = na.DescentOptions(iterations=1)
    found = na.synthesise(
        shipped, pendulum, na.Objective.of(na.effort()), pendulum.rest, seconds=0.5, options=options
    )
    assert len(found.controls) == 10


def test_a_pilot_is_loaded_says_where_it_is_and_prints_itself():
    pilot = na.Pilot.load("fish")
    frame = pilot.step(speed=0.5, dt=0.5)
    assert frame.pose.position.shape == (3,)
    forward = frame.pose.forward
    assert float(frame.pose.heading) == pytest.approx(np.arctan2(forward[1], forward[0]))
    assert repr(pilot).startswith('Pilot("fish", up to ')
    assert repr(pilot).endswith(" m/s, at 0.50 s)")


def test_a_pose_may_be_read_by_the_system():
    for name in ("fish", "truck"):
        system = na.load_system(name)
        pose = na.read_pose(system, system.rest)
        np.testing.assert_array_equal(
            pose.position, na.read_pose(system.structure, system.rest).position
        )


def test_goals_and_structures_print_themselves_in_a_line():
    pendulum, fish = na.load_system("pendulum"), na.load_system("fish")
    assert str(pendulum.goals["upright"]).startswith("Goal(state[0] = ")
    assert "23 mass points" in str(fish.structure)
    assert len(str(fish.structure)) < 200
