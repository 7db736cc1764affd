"""Objectives written in TOML: what is read is what was meant, and every mistake is named."""

from __future__ import annotations

import functools
import inspect
import json
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import Cli, read_glb
from jaxtyping import Array
from swing_up import stand_upright

from neuroanimator import DescentOptions, Emulator, Objective, load_system
from neuroanimator.cli.control import METHOD_HELP, run
from neuroanimator.control.descent.methods import METHODS
from neuroanimator.control.descent.options import DEFAULT_ITERATIONS
from neuroanimator.control.descent.parametrisation import EachStep, Periodic, Spline
from neuroanimator.control.objective import costs
from neuroanimator.control.objective.goals import is_reached, reach_goal, usual_goal
from neuroanimator.control.objective.objective import Moments, Trajectory
from neuroanimator.control.objective.obstacles import Zone, avoid
from neuroanimator.control.synthesis.attempt import SearchOptions
from neuroanimator.control.synthesis.objective_file import KINDS, ObjectiveFile, read_objective
from neuroanimator.control.synthesis.progress import watching
from neuroanimator.control.synthesis.synthesise import synthesise_goal
from neuroanimator.errors import ArgumentError, BadFileError
from neuroanimator.systems.goal import Goal
from neuroanimator.systems.system import System

DOCS = Path(__file__).parents[3] / "docs"
TUTORIAL = DOCS / "tutorials" / "my-objective.md"
REFERENCE = DOCS / "reference" / "control.md"


@functools.cache
def a_system(name: str) -> System:
    return load_system(name)


def read(folder: Path, text: str, system: str = "truck") -> ObjectiveFile:
    """Return what `text` asks for; a file without another one gets a header and a cost."""
    head = "" if "system =" in text else f'system = "{system}"\n'
    head += "" if "seconds =" in text else "seconds = 2.0\n"
    tail = "" if "costs" in text else '\n[[costs]]\nkind = "effort"\n'
    (folder / "my.toml").write_text(head + text + tail)
    return read_objective(folder / "my.toml", a_system(system))


def a_motion(system: System, steps: int = 8, dt: float = 0.25) -> Trajectory:
    rng = np.random.default_rng(0)
    states = system.rest + 0.1 * rng.normal(size=(steps + 1, system.state.size))
    controls = rng.uniform(-1, 1, (steps, system.control.size))
    return Trajectory(
        jnp.asarray(states), jnp.asarray(controls), jnp.asarray(system.bounds.magnitude), dt
    )


MEANT = {
    'kind = "effort"\nweight = 0.5': lambda truck: costs.effort(0.5),
    'kind = "smoothness"': lambda truck: costs.smoothness(),
    'kind = "travel"\ndirection = [1, 0, 0]\ndistance = 2\nwithin = 0.26': lambda truck: (
        costs.travel(truck, [1, 0, 0], 2.0, within=0.26)
    ),
    'kind = "reach_position"\nposition = [1.0, 2.0]\naxes = "xy"\nwithin = 0.1\nat = 1.5': lambda truck: (
        costs.reach_position(truck, [1.0, 2.0], axes="xy", within=0.1, at=1.5)
    ),
    'kind = "reach_height"\nheight = 2.0\nwithin = 0.1\nat = 1.5': lambda truck: costs.reach_height(
        truck, 2.0, within=0.1, at=1.5
    ),
    'kind = "reach_point"\nbody = "wheel_fl"\nposition = [1, 2, 0]\noffset = [0, 0, 1]\nwithin = 1\nsince = 1': lambda truck: (
        costs.reach_point(truck, "wheel_fl", [1, 2, 0], offset=[0, 0, 1], within=1.0, since=1.0)
    ),
    'kind = "reach_positions"\npositions = [[1, 2, 3], [2, 3, 4]]\ntimes = [1, 2]\nwithin = 1': lambda truck: (
        costs.reach_positions(truck, [[1, 2, 3], [2, 3, 4]], [1.0, 2.0], within=1.0)
    ),
    'kind = "follow_path"\npoints = [[0, 0], [1, 1]]\naxes = "xy"\nwithin = 1': lambda truck: (
        costs.follow_path(truck, [[0, 0], [1, 1]], axes="xy", within=1.0)
    ),
    'kind = "keep_velocity"\nvelocity = [1, 0, 0]\nwithin = 1\nsince = 1': lambda truck: (
        costs.keep_velocity(truck, [1, 0, 0], within=1.0, since=1.0)
    ),
    'kind = "keep_speed"\nspeed = 3\nwithin = 1': lambda truck: costs.keep_speed(
        truck, 3.0, within=1.0
    ),
    'kind = "keep_heading"\ndirection = [0, 1, 0]\nwithin = 0.1': lambda truck: costs.keep_heading(
        truck, [0, 1, 0], within=0.1
    ),
    'kind = "reach_heading"\ndirection = [0, 1, 0]\nwithin = 0.1': lambda truck: (
        costs.reach_heading(truck, [0, 1, 0], within=0.1)
    ),
    'kind = "stand_up"\nwithin = 0.1': lambda truck: costs.stand_up(truck, within=0.1),
    'kind = "stay_upright"\ntolerance = 0.01\nmay_pitch = true\nsince = 1': lambda truck: (
        costs.stay_upright(truck, tolerance=0.01, may_pitch=True, since=1.0)
    ),
    'kind = "stay_within"\npart = "steer_fl"\nlow = -0.1\nhigh = 0.05\nwithin = 1': lambda truck: (
        costs.stay_within(truck, "steer_fl", -0.1, 0.05, within=1.0)
    ),
    'kind = "avoid"\nzones = [{ position = [0.2, 0], radius = 0.5 }]\nmargin = 1': lambda truck: (
        avoid(truck, [Zone((0.2, 0.0), radius=0.5)], margin=1.0)
    ),
    'kind = "reach_state"\nreach = { "steer_fl" = [0.1] }\nwithin = { "steer_fl" = 0.02 }\nweight = 2': lambda truck: (
        reach_goal(truck, Goal(((truck.state.index("steer_fl").start, 0.1),), (0.02,)), weight=2.0)
    ),
    'kind = "goal"\nname = "bay_2"\nweight = 3\nat = 1': lambda truck: reach_goal(
        truck, truck.goals["bay_2"], weight=3.0, when=Moments((1.0,))
    ),
}


@eqx.filter_jit
def cost_and_residuals(objective: Objective, motion: Trajectory) -> tuple[Array, Array]:
    return objective(motion), objective.residuals(motion)


@pytest.mark.parametrize("text", sorted(MEANT))
def test_a_cost_in_a_file_is_the_cost_in_python(text: str, tmp_path: Path):
    truck = a_system("truck")
    found, meant = read(tmp_path, f"[[costs]]\n{text}").objective, Objective.of(MEANT[text](truck))
    motion = a_motion(truck)
    cost, wanted = cost_and_residuals(meant, motion)
    assert float(cost) > 0
    np.testing.assert_array_equal(cost_and_residuals(found, motion)[1], wanted)


def test_every_kind_is_tried_and_every_cost_has_a_kind():
    # A truck has no nodes: tests/physics/soft has a cloth's.
    assert {text.split('"')[1] for text in MEANT} == {*KINDS} - {"reach_node"}
    makers = {
        name
        for name, each in vars(costs).items()
        if inspect.isfunction(each) and each.__module__ == costs.__name__
    }
    assert {name for name in makers if name[0] != "_"} <= {*KINDS}


def test_the_tutorial_says_what_is_true(tmp_path: Path):
    text = TUTORIAL.read_text()
    wanted = read(tmp_path, text.split("```toml\n")[1].split("```")[0], "fish")
    assert isinstance(wanted.make_parametrisation(60, 0.05), Periodic)


def test_the_reference_lists_every_kind_and_its_arguments():
    lines = REFERENCE.read_text().splitlines()
    rows = {row.split("`")[1]: row for row in lines if row.startswith("| `")}
    assert {*rows} == {*KINDS}
    for kind, row in rows.items():
        taken = {name for name in inspect.signature(KINDS[kind]).parameters if name != "system"}
        assert {*row.split("|")[3].split("`")[1::2]} == taken, kind


def test_the_pendulums_goal_in_a_file_is_that_of_the_command_line(tmp_path: Path):
    text = '[[costs]]\nkind = "goal"\nname = "upright"\n[[costs]]\nkind = "effort"\n'
    pendulum = a_system("pendulum")
    file = read(tmp_path, text, "pendulum")
    motion = a_motion(pendulum)
    assert float(file.objective(motion)) == pytest.approx(float(stand_upright()(motion)), rel=1e-6)
    assert file.goals == (pendulum.goals["upright"],)


def test_a_state_wanted_at_the_end_is_judged_on_the_physics(tmp_path: Path):
    text = '[[costs]]\nkind = "reach_state"\nreach = { "root.position" = [1, 2, 0.5] }\nwithin = { "root.position" = 0.2 }\n'
    truck = a_system("truck")
    state = np.array(truck.rest)
    (goal,) = read(tmp_path, text).goals
    assert not is_reached(truck, goal, state)
    state[:3] = [1.1, 2.1, 0.4]
    assert is_reached(truck, goal, state)
    assert read(tmp_path, text + "at = 1").goals == ()


def test_a_goal_may_be_written_after_training(shipped: Emulator):
    later = load_system("pendulum")
    start = (0.3, -0.2, 0.1, 0.0, 0.0, 0.0)
    later.goals = {"aside": Goal(((0, 0.5),), (0.2,), 0.5, start)}
    found = synthesise_goal(
        shipped,
        later,
        "aside",
        options=SearchOptions(DescentOptions(iterations=6), corrections=1),
    )
    assert found.is_reached
    np.testing.assert_allclose(found.outcome.physics_states[0], start)
    with pytest.raises(
        ArgumentError, match="truck has another state or control than the emulator's pendulum"
    ):
        synthesise_goal(shipped, load_system("truck"), "bay_1")


def test_who_names_no_goal_is_told_how_to_write_one():
    assert usual_goal(a_system("pendulum")) == "upright"
    with pytest.raises(ArgumentError, match="Say which: --goal bay_1, --goal bay_2"):
        usual_goal(a_system("truck"))
    with pytest.raises(ArgumentError) as caught:
        usual_goal(load_system("pendulum-passive"))
    assert 'kind = "reach_state", reach = { "angle" = [1.0, 1.0, 1.0] }' in str(caught.value)


def test_what_may_vary_is_what_the_file_says(tmp_path: Path):
    assert isinstance(read(tmp_path, "").make_parametrisation(20, 0.1), EachStep)
    spline = read(tmp_path, 'parametrisation = "spline"\nknots = 5').make_parametrisation(20, 0.1)
    assert isinstance(spline, Spline)
    assert spline.size == 5 * a_system("truck").control.size
    assert isinstance(
        read(tmp_path, 'parametrisation = "periodic"\nperiod = 0.7').make_parametrisation(20, 0.1),
        Periodic,
    )
    swim = read(tmp_path, 'parametrisation = "periodic"', "fish").make_parametrisation(20, 0.1)
    assert isinstance(swim, Periodic)
    assert float(swim.period) == pytest.approx(a_system("fish").gait.period)


def test_a_motion_begins_where_the_file_says_with_turns_of_unit_length(tmp_path: Path):
    truck = a_system("truck")
    start = read(
        tmp_path, 'start = { "root.position" = [1, 2, 0.5], "root.orientation" = [0, 0, 0, 2] }'
    ).start
    np.testing.assert_array_equal(start[:7], [1, 2, 0.5, 0, 0, 0, 1])
    np.testing.assert_array_equal(start[7:], truck.rest[7:])
    np.testing.assert_array_equal(read(tmp_path, "").start, truck.rest)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("system = 3", "my.toml: system: input should be a valid string"),
        ('system = "fish"', "my.toml: system: this objective is for fish, the emulator of truck"),
        ("seconds = nan", "my.toml: seconds: "),
        ("seconds = 60", "my.toml: seconds: "),
        ("colour = 1", "my.toml: colour: "),
        (
            'parametrisation = "wave"',
            "parametrisation: input should be 'each step', 'spline' or 'periodic'",
        ),
        ("knots = 5", 'knots: goes with parametrisation = "spline" only'),
        ('parametrisation = "spline"\nknots = 3', "knots: "),
        ('parametrisation = "periodic"', "period: wanted one"),
        ("starts = 0", "starts: "),
        (
            "start = { wheel = [1] }",
            "no part called 'wheel'. Did you mean wheel_rr? Parts, how many numbers and their unit: root.position (3, m)",
        ),
        ('start = { "root.position" = [1] }', "'root.position' has 3 numbers [m], got 1"),
        ('start = { "root.orientation" = [0, 0, 0, 0] }', "quaternion"),
        ("costs = []", "my.toml: costs: "),
        ("[[costs]]\nweight = 1", "cost 1: no kind 'None'. Kinds: avoid, effort"),
        (
            '[[costs]]\nkind = "effort"\n[[costs]]\nkind = "fly"',
            "cost 2: no kind 'fly'. Kinds: avoid, effort",
        ),
        (
            '[[costs]]\nkind = "keep_speed"\nspeed = 1\nwithn = 1',
            "cost 1 (keep_speed): no argument 'withn'. Arguments: speed, within, since, weight; needed: speed, within.",
        ),
        (
            '[[costs]]\nkind = "keep_speed"\nspeed = 1',
            "cost 1 (keep_speed): wanted 'within'. Arguments: speed",
        ),
        (
            '[[costs]]\nkind = "effort"\nweight = "1"',
            "cost 1 (effort): weight: input should be a valid number",
        ),
        (
            '[[costs]]\nkind = "effort"\nweight = true',
            "cost 1 (effort): weight: input should be a valid number",
        ),
        (
            '[[costs]]\nkind = "effort"\nweight = inf',
            "cost 1 (effort): weight: input should be a finite number",
        ),
        (
            '[[costs]]\nkind = "reach_position"\nposition = [1, "2", 3]\nwithin = 1',
            "position: wanted real numbers",
        ),
        (
            '[[costs]]\nkind = "reach_position"\nposition = [1, 2]\nwithin = 1',
            "wanted rows of 3 finite numbers",
        ),
        (
            '[[costs]]\nkind = "reach_position"\nposition = [1]\naxes = "w"\nwithin = 1',
            "axes: wanted some of x, y, z",
        ),
        (
            '[[costs]]\nkind = "follow_path"\npoints = [[1, 2], [3]]\nwithin = 1',
            "points: wanted numbers in rows equally long",
        ),
        (
            '[[costs]]\nkind = "stand_up"\nwithin = -1',
            "cost 1 (stand_up): within: wanted a finite number above 0",
        ),
        (
            '[[costs]]\nkind = "goal"\nname = "moon"',
            "cost 1 (goal): No goal called 'moon' for the system truck. Goals:",
        ),
        (
            '[[costs]]\nkind = "reach_state"\nreach = {}',
            "cost 1 (reach_state): reach: wanted at least one part",
        ),
        (
            '[[costs]]\nkind = "reach_state"\nreach = { wheel = [1] }',
            "No part called 'wheel'. Did you mean wheel_rr? Parts: root.position",
        ),
        (
            '[[costs]]\nkind = "reach_state"\nreach = { steer_fl = [1, 2] }',
            "'steer_fl' has 1 numbers",
        ),
        (
            '[[costs]]\nkind = "reach_state"\nreach = { steer_fl = ["1"] }',
            "reach.steer_fl.0: input should be",
        ),
        (
            '[[costs]]\nkind = "reach_state"\nreach = { steer_fl = [1] }\nwithin = { steer_fl = 0 }',
            "cost 1 (reach_state): within.steer_fl: input should be greater than 0",
        ),
        (
            '[[costs]]\nkind = "avoid"\nmargin = 1\nzones = [{ radius = 1 }]',
            "cost 1 (avoid): zones.0.position: field req",
        ),
        ("[[wishes", "is not a readable TOML file"),
    ],
)
def test_a_mistake_in_a_file_gets_one_line_that_names_it(text: str, message: str, tmp_path: Path):
    with pytest.raises(BadFileError) as caught:
        read(tmp_path, text)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert caught.value.exit_code == 3


def test_the_log_holds_a_line_per_iteration_as_soon_as_it_is_told(tmp_path: Path):
    path = tmp_path / "new" / "curve.jsonl"

    def rows():
        return [json.loads(line) for line in path.read_text().splitlines()]

    with watching(path, 3) as on_iteration:
        for iteration, cost in ((1, 4.0), (2, 2.0), (1, float("nan"))):
            on_iteration(iteration, cost)
            assert rows()[-1]["J"] == (cost if cost == cost else None)
    assert [(row["descent"], row["iteration"]) for row in rows()] == [(1, 1), (1, 2), (2, 3)]
    assert sorted(rows()[0]) == ["J", "descent", "iteration", "seconds"]


def test_help_says_what_descents_do():
    assert all(name in METHOD_HELP for name in METHODS)
    assert inspect.signature(run).parameters["iterations"].default == DEFAULT_ITERATIONS


def test_a_controller_is_found_logged_and_shown_with_its_ghost(cli: Cli, tmp_path: Path):
    text = 'system = "pendulum"\nseconds = 1.0\nparametrisation = "spline"\nknots = 8\n'
    text += '[[costs]]\nkind = "goal"\nname = "upright"\n[[costs]]\nkind = "effort"\nweight = 0.1\n'
    (tmp_path / "my.toml").write_text(text)
    files = ["--out", "c.csv", "--log", "curve.jsonl", "--glb", "motion.glb"]
    found = cli(
        "control", "pendulum", "--objective", "my.toml", "--starts", 3, *files, cwd=tmp_path
    )
    assert found.returncode == 0, found.stderr
    assert "goal reached on the true physics" in found.stdout
    assert found.stderr == ""
    costs = [json.loads(line) for line in (tmp_path / "curve.jsonl").read_text().splitlines()]
    first = [row["J"] for row in costs if row["descent"] == 1]
    assert first == sorted(first, reverse=True)
    assert len(np.loadtxt(tmp_path / "c.csv", delimiter=",", skiprows=1)) == 20
    document, _ = read_glb(tmp_path / "motion.glb")
    names = [node["name"] for node in document["nodes"]]
    assert [f"ghost {name}" for name in names[: len(names) // 2]] == names[len(names) // 2 :]


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--goal", "upright"], 2, "--goal, --seconds, --start, --effort-weight and --threshold"),
        (["--seconds", "2"], 2, "--goal, --seconds, --start, --effort-weight and --threshold"),
        (["--glb", "motion.gif"], 2, "ends in none of"),
        ([], 3, "my.toml: cost 1: no kind 'fly'"),
    ],
)
def test_a_mistake_on_the_command_line_leaves_no_file(
    options, code: int, message: str, cli: Cli, tmp_path: Path
):
    (tmp_path / "my.toml").write_text(
        'system = "pendulum"\nseconds = 1.0\n[[costs]]\nkind = "fly"\n'
    )
    files = ["--out", "c.csv", "--log", "curve.jsonl"]
    result = cli("control", "pendulum", "--objective", "my.toml", *files, *options, cwd=tmp_path)
    assert (result.returncode, len(result.stderr.splitlines())) == (code, 1), result.stderr
    assert message in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["my.toml"]
