"""Cost terms and parameters keep their laws: symmetry, slopes, sums over time, bounds."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from swing_up import stand_upright

from neuroanimator import (
    DescentOptions,
    Emulator,
    Objective,
    descend,
    load_emulator,
    load_system,
    read_pose,
)
from neuroanimator.codegen.compiler import find_compiler
from neuroanimator.control.descent.parametrisation import (
    EachStep,
    Parametrisation,
    Periodic,
    Spline,
    Steered,
)
from neuroanimator.control.objective.c_objective import c_objective
from neuroanimator.control.objective.costs import (
    effort,
    follow_path,
    keep_heading,
    keep_speed,
    keep_velocity,
    reach_heading,
    reach_height,
    reach_point,
    reach_position,
    reach_positions,
    smoothness,
    stand_up,
    stay_upright,
    stay_within,
    travel,
)
from neuroanimator.control.objective.goals import ReachState, reach_goal
from neuroanimator.control.objective.objective import AT_THE_END, CostTerm, Trajectory
from neuroanimator.control.objective.objective_cost import check_objective, cost_and_slopes
from neuroanimator.emulator.arrays import as_float32
from neuroanimator.errors import ArgumentError
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.layout import Bounds
from neuroanimator.state.rotation import multiply, rotate
from neuroanimator.systems.system import System

BODIES = ("fish", "truck")
PLACES = np.array([[0.3, -0.2, 0.1], [1.0, 0.5, 0.3]])
DIRECTION = np.array([0.6, 0.8, 0.0])
SHIFT = np.array([3.0, -2.0, 1.0])
TURN = np.array([0.5, -0.5, 0.1, 0.7]) / np.linalg.norm([0.5, -0.5, 0.1, 0.7])
UPRIGHT_TURN = np.array([0.8, 0.0, 0.0, 0.6])
"""A turn about the vertical, which leaves up where it is."""
DT, STEPS = 0.05, 8
HALF_WAY = (0.05, -0.02, 0.1)
"""A point off the origin of a wheel [m]."""
BOUNDS = Bounds((-2.0, 0.0, -1.0), (2.0, 5.0, 3.0))


@functools.cache
def a_system(name: str) -> System:
    return load_system(name)


def a_motion(system: System, seed: int = 0, steps: int = STEPS, dt: float = DT) -> Trajectory:
    """Return a wild motion: the laws hold for any."""
    rng = np.random.default_rng(seed)
    states = system.rest + 0.1 * rng.normal(size=(steps + 1, system.state.size))
    for orientation, _ in Frame.of(system.structure, 0.0).orientations:
        states[:, orientation : orientation + 4] /= np.linalg.norm(
            states[:, orientation : orientation + 4], axis=1, keepdims=True
        )
    controls = rng.uniform(-1, 1, (steps, system.control.size))
    return Trajectory(
        jnp.asarray(states), jnp.asarray(controls), jnp.asarray(system.bounds.magnitude), dt
    )


@eqx.filter_jit
def residuals_of(term: CostTerm, motion: Trajectory) -> jax.Array:
    """Return the residuals, compiled as a whole: operation by operation would take several times as long."""
    return term.residuals(motion)


@eqx.filter_jit
def value_of(objective: Objective, motion: Trajectory) -> jax.Array:
    """Return J, compiled as a whole."""
    return objective(motion)


@eqx.filter_jit
def slope_of(objective: Objective, motion: Trajectory) -> jax.Array:
    """Return the slope of J by the states, compiled as a whole."""
    return jax.grad(lambda states: objective(motion._replace(states=states)))(motion.states)


def cost_of(motion: Trajectory, *costs: Any) -> float:
    """Return the sum of `costs` of `motion`."""
    return float(value_of(Objective.of(*costs), motion))


def turned(vectors: np.ndarray, orientation: np.ndarray) -> np.ndarray:
    """Return `vectors` (..., 3) in a world turned by `orientation`."""
    return rotate(np.broadcast_to(orientation, (*vectors.shape[:-1], 4)), vectors)


def moved(system: System, states: np.ndarray, orientation: np.ndarray) -> np.ndarray:
    """Return the same states (..., S) in a world turned by `orientation` and then shifted."""
    there, start = np.array(states, float), 0
    for segment in system.structure.segments:
        part, start = slice(start, start + segment.size), start + segment.size
        if segment.kind == "quaternion":
            there[..., part] = multiply(
                np.broadcast_to(orientation, there[..., part].shape), there[..., part]
            )
        elif segment.kind in ("position", "velocity", "points", "point velocities"):
            vectors = there[..., part].reshape(*there.shape[:-1], -1, 3)
            shift = SHIFT if segment.kind in ("position", "points") else 0
            there[..., part] = (turned(vectors, orientation) + shift).reshape(
                there[..., part].shape
            )
    return there


MovedCost = Callable[
    [System, Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]], CostTerm
]
"""(system, where a place is in the moved world, where a direction points there) → a cost term."""

MOVING: dict[str, MovedCost] = {
    "reach_position": lambda system, position, way: reach_position(
        system, position(PLACES[0]), within=0.1
    ),
    "reach_positions": lambda system, position, way: reach_positions(
        system, position(PLACES), [0.1, 0.3], within=0.1
    ),
    "follow_path": lambda system, position, way: follow_path(system, position(PLACES), within=0.1),
    "travel": lambda system, position, way: travel(system, way(DIRECTION), 0.5, within=0.1),
    "keep_velocity": lambda system, position, way: keep_velocity(
        system, way(DIRECTION), within=0.1, since=0.2
    ),
    "keep_speed": lambda system, position, way: keep_speed(system, 0.7, within=0.1),
    "keep_heading": lambda system, position, way: keep_heading(system, way(DIRECTION), within=0.1),
    "reach_height": lambda system, position, way: reach_height(
        system, 9 + float(position(PLACES[0])[2]), within=0.1, at=0.2
    ),
    "reach_heading": lambda system, position, way: reach_heading(
        system, way(DIRECTION), within=0.1, at=0.2
    ),
    "stand_up": lambda system, position, way: stand_up(system, within=0.1),
    "stay_upright": lambda system, position, way: stay_upright(system, tolerance=0.01),
    "stay_unrolled": lambda system, position, way: stay_upright(
        system, tolerance=0.01, may_pitch=True
    ),
}
ONLY_UP = ("stand_up", "stay_upright", "stay_unrolled")
"""Cost terms that look at the vertical alone."""


def as_is(vector: np.ndarray) -> np.ndarray:
    return vector


def reach_other(system: System, orientation: np.ndarray | None) -> ReachState:
    """Return the cost of not being in the third state of another motion, which moves with the world for an `orientation`."""
    state = np.asarray(a_motion(system, seed=1).states[2], float)
    frame = Frame.of(system.structure, 0.0)
    goal = state if orientation is None else moved(system, state, orientation)
    judged = np.eye(frame.change_size(len(state)), dtype=np.float32)
    return ReachState(
        weight=np.float32(1.0), when=AT_THE_END, frame=frame, goal=as_float32(goal), judged=judged
    )


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("kind", sorted(MOVING))
def test_moving_and_turning_world_and_goal_together_changes_nothing(kind: str, body: str):
    system, orientation = (
        a_system(body),
        UPRIGHT_TURN if kind in (*ONLY_UP, "reach_height") else TURN,
    )
    here = MOVING[kind](system, as_is, as_is)
    there = MOVING[kind](
        system,
        lambda position: turned(position, orientation) + SHIFT,
        lambda way: turned(way, orientation),
    )
    motion = a_motion(system)
    elsewhere = motion._replace(states=jnp.asarray(moved(system, motion.states, orientation)))
    before = residuals_of(here, motion)
    after = residuals_of(there, elsewhere)
    assert cost_of(elsewhere, here) != pytest.approx(cost_of(motion, here), rel=1e-3) or (
        kind in ("keep_speed", *ONLY_UP)  # those that name no place and no heading
    )
    np.testing.assert_allclose(np.linalg.norm(after), np.linalg.norm(before), rtol=1e-4)


@pytest.mark.parametrize("body", BODIES)
def test_a_state_is_compared_as_seen_from_the_goal(body: str):
    system, motion = a_system(body), a_motion(a_system(body))
    elsewhere = motion._replace(states=jnp.asarray(moved(system, motion.states, TURN)))
    before = np.asarray(residuals_of(reach_other(system, None), motion))
    after = residuals_of(reach_other(system, TURN), elsewhere)
    assert np.linalg.norm(before) > 0.1
    np.testing.assert_allclose(after, before, atol=2e-5 * float(np.abs(before).max()))


EVERY: dict[str, Callable[[System], CostTerm]] = {
    **{kind: lambda system, make=make: make(system, as_is, as_is) for kind, make in MOVING.items()},
    "effort": lambda system: effort(0.3),
    "smoothness": lambda system: smoothness(0.2),
    "reach_state": lambda system: reach_other(system, None),
    "stay_within": lambda system: stay_within(
        system, system.state.slices[0].name, -0.05, 0.03, within=0.1
    ),
}


@pytest.mark.parametrize("body", BODIES)
def test_slopes_equal_finite_differences(body: str):
    with jax.enable_x64(True):

        def exact(leaf):
            return jnp.asarray(np.asarray(leaf), jnp.float64) if eqx.is_array(leaf) else leaf

        system, rng, size = a_system(body), np.random.default_rng(1), 1e-6
        terms = [jax.tree.map(exact, make(system)) for make in EVERY.values()]
        motion = jax.tree.map(exact, a_motion(system))
        ways = [exact(rng.normal(size=each.shape)) for each in (motion.states, motion.controls)]

        @jax.jit
        def costs(states: jax.Array, controls: jax.Array) -> jax.Array:
            path = motion._replace(states=states, controls=controls)
            return jnp.stack([Objective.of(term)(path) for term in terms])

        slopes = jax.jit(jax.jacrev(costs, (0, 1)))(motion.states, motion.controls)
        along = sum(jnp.tensordot(slope, way, 2) for slope, way in zip(slopes, ways, strict=True))
        ends = [
            costs(motion.states + s * size * ways[0], motion.controls + s * size * ways[1])
            for s in (-1, 1)
        ]
        differences = (ends[1] - ends[0]) / (2 * size)
        for kind, slope, difference in zip(
            EVERY, along.tolist(), differences.tolist(), strict=True
        ):
            assert abs(slope) > 1e-4, kind
            assert slope == pytest.approx(difference, rel=1e-5), kind
        looks_at_states = np.abs(slopes[0]).max(axis=(1, 2)) > 0
        assert [not term.of_controls for term in terms] == looks_at_states.tolist()


def test_a_point_of_the_body_is_where_mujoco_has_it():
    system = a_system("truck")
    assert isinstance(system, MujocoSystem)
    wheel = reach_point(system, "wheel_fl", [0, 0, 0], offset=HALF_WAY, within=1, since=0)
    states = system.sample_starts(np.random.default_rng(0), 8)
    data = mujoco.MjData(system.model)
    for state in states:
        system.put(data, state)
        mujoco.mj_forward(system.model, data)
        body = data.body("wheel_fl")
        there = body.xpos + body.xmat.reshape(3, 3) @ HALF_WAY
        np.testing.assert_allclose(wheel.observe(jnp.asarray(state)), there, atol=1e-5)


def test_where_no_root_is_free_travel_names_the_bodies_that_may_come_forward():
    with pytest.raises(ArgumentError, match='body = "upper", or another of upper, middle, lower'):
        travel(load_system("pendulum"), [1, 0, 0], 2.0, within=0.1)


def test_one_body_of_many_travels_as_the_root_that_carries_it():
    system, motion = a_system("truck"), steady(a_system("truck"), 0.6, 1.0, DT)
    forward = travel(system, [1, 0, 0], 2.0, within=0.1)
    wheel = travel(system, [1, 0, 0], 2.0, within=0.1, body="wheel_fl")
    assert cost_of(motion, wheel) == pytest.approx(cost_of(motion, forward), rel=1e-5)


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_costs_of_positions_and_velocities_are_the_same_in_c():
    """The others are part of descents in C: see `test_c_evaluator`."""
    system = a_system("truck")
    emulator = load_emulator("truck-50")
    motion = a_motion(system, dt=emulator.dt)
    kinds = ("reach_positions", "reach_height", "follow_path", "keep_velocity", "keep_speed")
    wheel = reach_point(system, "wheel_fl", PLACES[0], offset=HALF_WAY, within=0.1, since=0.1)
    forward = travel(system, [1, 0, 0], 2.0, within=0.3, body="wheel_fl", since=0.1)
    objective = Objective.of(wheel, forward, *(EVERY[kind](system) for kind in kinds))
    in_c = c_objective(objective, emulator, STEPS, as_float32(motion.control_scale))
    assert in_c is not None
    found, found_slopes = in_c.cost_and_slopes(
        as_float32(motion.states), as_float32(motion.controls)
    )
    expected, expected_slopes = cost_and_slopes(objective, motion)
    assert found == pytest.approx(float(expected), rel=1e-4)
    for slope, wanted in zip(found_slopes, expected_slopes, strict=True):
        np.testing.assert_allclose(slope, wanted, atol=1e-4 * float(np.abs(wanted).max()))


def steady(system: System, speed: float, seconds: float, dt: float) -> Trajectory:
    """Return the body at rest but for going forward, along its own X, at `speed` [m/s]."""
    steps = round(seconds / dt)
    states, start = np.repeat(system.rest[None], steps + 1, axis=0), 0
    way = speed * dt * np.arange(steps + 1)
    for segment in system.structure.segments:
        forward = slice(start, start + segment.size, 3)
        if segment.kind in ("position", "points"):
            states[:, forward] += way[:, None]
        elif segment.kind in ("velocity", "point velocities"):
            states[:, forward] = speed
        start += segment.size
    controls = np.tile(0.5 * system.bounds.magnitude, (steps, 1))
    return Trajectory(
        jnp.asarray(states), jnp.asarray(controls), jnp.asarray(system.bounds.magnitude), dt
    )


@pytest.mark.parametrize("body", BODIES)
def test_a_body_at_known_speed_gives_the_known_cost(body: str):
    system, motion = a_system(body), steady(a_system(body), 0.6, 2.0, DT)

    def cost(*costs):
        return cost_of(motion, *costs)

    assert cost(travel(system, [1, 0, 0], 1.2, within=0.1)) == pytest.approx(0, abs=1e-8)
    assert cost(travel(system, [2, 0, 0], 1.5, within=0.1)) == pytest.approx(
        (0.3 / 0.1) ** 2 / 2, rel=1e-4
    )
    assert cost(travel(system, [0, 1, 0], 0.4, within=0.1)) == pytest.approx(4**2 / 2, rel=1e-4)
    late = DT * np.arange(round(1 / DT), round(2 / DT) + 1)
    behind = np.sum((1.2 - 0.6 * late) ** 2) * DT
    assert cost(travel(system, [1, 0, 0], 1.2, within=1, since=1.0)) == pytest.approx(
        behind / 2, rel=1e-3
    )
    assert cost(keep_speed(system, 0.6, within=0.1)) == pytest.approx(0, abs=1e-8)
    assert cost(keep_speed(system, 0.5, within=0.1)) == pytest.approx(1**2 / 2 * 2.0, rel=1e-4)
    assert cost(keep_speed(system, 0.5, within=0.1, since=1.0)) == pytest.approx(
        0.5 * (1.0 + DT), rel=1e-4
    )
    assert cost(keep_velocity(system, [0.6, 0.1, 0], within=0.1)) == pytest.approx(
        0.5 * 2.0, rel=1e-4
    )
    assert cost(keep_heading(system, [1, 0, 0], within=0.1)) == pytest.approx(0, abs=1e-8)
    assert cost(stand_up(system, within=0.1)) == pytest.approx(0, abs=1e-8)
    assert cost(effort(3.0)) == pytest.approx(3 / 2 * 0.25 * system.control.size * 2.0, rel=1e-5)


@pytest.mark.parametrize("body", BODIES)
def test_sums_over_time_do_not_depend_on_the_super_step(body: str):
    system = a_system(body)
    part = system.state.slices[0].name
    costs = (
        effort(),
        keep_speed(system, 0.2, within=0.1),
        keep_velocity(system, [0, 0.1, 0], within=0.1),
        keep_heading(system, [0, 1, 0], within=0.1),
        follow_path(system, [[0, 1, 0], [1, 1, 0]], within=0.1),
        stay_within(system, part, -0.3, 0.1, within=0.1),
    )
    for term in costs:
        coarse, fine = (cost_of(steady(system, 0.6, 2.0, dt), term) for dt in (DT, DT / 2))
        assert coarse > 0.1
        assert fine == pytest.approx(coarse, rel=0.08), type(
            term
        ).__name__  # a sum is an integral but for its ends


def leaning(system: System, orientation: np.ndarray, seconds: float = 2.0) -> Trajectory:
    """Return the body at rest, turned by `orientation` all the time."""
    return still(system, moved(system, system.rest, orientation), seconds)


def still(system: System, state: np.ndarray, seconds: float) -> Trajectory:
    """Return the motion that stays in `state` (S,)."""
    steps = round(seconds / DT)
    states = np.repeat(state[None], steps + 1, axis=0)
    return Trajectory(jnp.asarray(states), jnp.zeros((steps, 1)), jnp.ones(1), DT)


ROLLED, PITCHED = (
    np.array([np.cos(0.4), *axis]) for axis in ([np.sin(0.4), 0, 0], [0, np.sin(0.4), 0])
)
"""By 0.8 rad about a body's own X, or its Y."""
BELLY_UP = np.array([0.0, 1.0, 0.0, 0.0])


@pytest.mark.parametrize("body", BODIES)
def test_leaning_beyond_the_tolerance_costs_as_long_as_it_lasts(body: str):
    system, upright = a_system(body), np.array([1.0, 0, 0, 0])

    def cost(orientation: np.ndarray, **choices: Any) -> float:
        term = stay_upright(system, tolerance=0.3, within=0.1, **choices)
        return cost_of(leaning(system, orientation), term)

    assert cost(upright) == 0
    assert cost(ROLLED) == pytest.approx(5**2 / 2 * 2.0, rel=1e-3)
    assert cost(PITCHED) == pytest.approx(5**2 / 2 * 2.0, rel=1e-3)
    assert cost(BELLY_UP) == pytest.approx(((np.pi - 0.3) / 0.1) ** 2 / 2 * 2.0, rel=1e-3)
    assert cost(ROLLED, since=1.0) == pytest.approx(5**2 / 2 * (1.0 + DT), rel=1e-3)
    assert cost(PITCHED, may_pitch=True) == 0
    assert cost(ROLLED, may_pitch=True) == pytest.approx(cost(ROLLED), rel=1e-3)
    assert cost(multiply(PITCHED, ROLLED), may_pitch=True) == pytest.approx(cost(ROLLED), rel=1e-3)


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("orientation", [np.array([1.0, 0, 0, 0]), BELLY_UP, ROLLED])
def test_staying_upright_has_a_finite_slope_wherever_a_body_lies(
    orientation: np.ndarray, body: str
):
    system = a_system(body)
    motion = leaning(system, orientation)
    for may_pitch in (True, False):
        objective = Objective.of(stay_upright(system, may_pitch=may_pitch))
        assert np.isfinite(slope_of(objective, motion)).all()


@pytest.mark.parametrize("body", BODIES)
def test_roll_is_told_about_the_bodys_own_axis(body: str):
    system = a_system(body)

    def roll(orientation):
        return float(read_pose(system.structure, moved(system, system.rest, orientation)).roll)

    assert roll(ROLLED) == pytest.approx(0.8, abs=1e-6)
    assert roll(multiply(UPRIGHT_TURN, multiply(PITCHED, ROLLED))) == pytest.approx(0.8, abs=1e-6)
    assert roll(PITCHED) == pytest.approx(0, abs=1e-6)
    assert abs(roll(BELLY_UP)) == pytest.approx(np.pi, abs=1e-6)


def test_smoothness_is_the_same_for_a_ramp_in_finer_steps():
    def cost(steps: int) -> float:
        dt, ramp = 2.0 / steps, np.linspace(0, 1, steps, endpoint=False)[:, None]
        motion = Trajectory(np.zeros((steps + 1, 1)), jnp.asarray(ramp), np.ones(1), dt)
        return cost_of(motion, smoothness(1.0))

    assert cost(100) == pytest.approx(0.5 * 0.5**2 * 2.0, rel=0.02)
    assert cost(200) == pytest.approx(cost(100), rel=0.01)


@pytest.mark.parametrize("body", BODIES)
def test_costs_are_linear_in_weights_and_add_up(body: str):
    system, motion = a_system(body), a_motion(a_system(body))
    light, heavy = (keep_speed(system, 0.3, within=0.1, weight=weight) for weight in (1.0, 2.0))
    assert cost_of(motion, heavy) == pytest.approx(2 * cost_of(motion, light), rel=1e-6)

    def own(trajectory: Trajectory) -> jax.Array:
        return jnp.mean(trajectory.states**2)

    costs = [make(system) for make in EVERY.values()]
    apart = sum(cost_of(motion, term) for term in (*costs, own))
    together = Objective.of(*costs, own)
    assert cost_of(motion, *costs, own) == pytest.approx(apart, rel=1e-5)
    residuals = eqx.filter_eval_shape(together.residuals, motion)
    apart_sizes = [len(eqx.filter_eval_shape(cost.residuals, motion)) for cost in costs]
    assert len(residuals) == sum(apart_sizes)


def test_a_goals_tolerance_is_an_error_of_three():
    truck = a_system("truck")
    goal = truck.goals["bay_1"]
    term, state = reach_goal(truck, goal), np.array(truck.rest)
    for entry, value in goal.values:
        state[entry] = value

    def at(state):
        return Trajectory(jnp.asarray(state[None]), jnp.zeros((0, 2)), jnp.ones(2), DT)

    np.testing.assert_allclose(residuals_of(term, at(state)), 0, atol=1e-6)
    speed = truck.state.index("root.velocity").start
    tolerance = dict(zip([entry for entry, _ in goal.values], goal.tolerances, strict=True))[speed]
    state[speed : speed + 3] += turned(np.array([tolerance, 0, 0]), state[3:7])
    assert np.abs(residuals_of(term, at(state))).max() == pytest.approx(3, rel=1e-4)


PARAMETERS: dict[str, Callable[[int], Parametrisation]] = {
    "each step": lambda steps: EachStep.of(steps, BOUNDS),
    "spline": lambda steps: Spline.of(steps, 7, BOUNDS),
    "periodic": lambda steps: Periodic.of(steps, DT, 0.6, BOUNDS),
    "steered": lambda steps: Steered.of(steps, DT, 0.6, 5, BOUNDS),
}


@pytest.mark.parametrize("kind", sorted(PARAMETERS))
def test_guessing_from_controls_gives_these_controls(kind: str):
    parametrisation = PARAMETERS[kind](40)
    z = np.random.default_rng(0).normal(size=parametrisation.size)
    if isinstance(parametrisation, Periodic | Steered):
        z[0] = 0.0  # its frequency is that of the first guess
    controls = np.asarray(parametrisation.controls(jnp.asarray(z)))
    found = parametrisation.guess(controls)
    np.testing.assert_allclose(found, z, atol=2e-2)
    np.testing.assert_allclose(parametrisation.controls(jnp.asarray(found)), controls, atol=1e-3)


@pytest.mark.parametrize("kind", sorted(PARAMETERS))
def test_controls_are_within_bounds_and_smooth_in_z_however_large_it_is(kind: str):
    parametrisation = PARAMETERS[kind](40)
    np.testing.assert_allclose(
        parametrisation.controls(jnp.asarray(parametrisation.guess(None)))[0],
        BOUNDS.middle,
        atol=1e-6,
    )
    controls_at = eqx.filter_jit(parametrisation.controls)
    slope_at = jax.jit(jax.grad(lambda z: jnp.sum(parametrisation.controls(z) ** 2)))
    for size in (1.0, 1e3, 1e30):
        z = jnp.asarray(
            size * np.random.default_rng(0).normal(size=parametrisation.size), jnp.float32
        )
        controls = np.asarray(controls_at(z))
        assert (controls >= np.array(BOUNDS.low) - 1e-6).all()
        assert (controls <= np.array(BOUNDS.high) + 1e-6).all()
        assert np.isfinite(slope_at(z)).all()
    at_bounds = np.tile(BOUNDS.high, (40, 1))
    assert np.isfinite(parametrisation.guess(at_bounds)).all()


def test_a_spline_is_close_to_a_smooth_curve_and_closer_with_more_knots():
    share = (np.arange(60) + 0.5) / 60
    curve = BOUNDS.middle + 0.6 * np.sin(2 * np.pi * share)[:, None] * BOUNDS.half

    def off(knots: int) -> float:
        spline = Spline.of(60, knots, BOUNDS)
        return float(
            np.abs(
                (np.asarray(spline.controls(jnp.asarray(spline.guess(curve)))) - curve)
                / BOUNDS.half
            ).max()
        )

    assert off(8) < 0.02
    assert off(16) < off(8) / 4


def test_a_periodic_pattern_is_a_gait_and_repeats():
    periodic, z = Periodic.of(48, DT, 0.6, BOUNDS), np.random.default_rng(0).normal(size=10)
    z[:4] = [0.0, 0.0, 0.0, 0.0]  # the first frequency, and no offsets
    controls = np.asarray(periodic.controls(jnp.asarray(z)))
    np.testing.assert_allclose(controls[12:24], controls[:12], atol=1e-4)
    weak = z * 1e-2
    both_ways = Bounds.symmetric(BOUNDS.half)  # a gait is about the idle control
    periodic = Periodic.of(48, DT, 0.6, both_ways)
    gait = periodic.gait(weak).controls(48, DT, both_ways)
    np.testing.assert_allclose(gait, periodic.controls(jnp.asarray(weak)), atol=1e-3)


def test_all_of_a_body_is_up_only_when_its_lowest_mass_point_is():
    fish = a_system("fish")
    low = float(fish.rest[2 : 3 * 23 : 3].min())
    there = Trajectory(
        jnp.asarray(fish.rest[None], jnp.float32), jnp.zeros((0, 12)), jnp.ones(12), DT
    )
    reached, missed = (
        np.asarray(reach_height(fish, low + shift, within=0.01).residuals(there))
        for shift in (-1e-4, 0.015)
    )
    assert (reached == 0).all()
    assert (missed > 0).sum() == (fish.rest[2 : 3 * 23 : 3] < low + 0.015).sum()


def not_a_number(trajectory: Trajectory) -> jax.Array:
    return jnp.sum(trajectory.states) * jnp.nan


def many_numbers(trajectory: Trajectory) -> jax.Array:
    return trajectory.states[0]


def square_root(trajectory: Trajectory) -> jax.Array:
    return jnp.sqrt(jnp.sum(trajectory.states**2))


def failing(trajectory: Trajectory) -> jax.Array:
    raise KeyError("speed")


REFUSED_COSTS = {
    "applies at 9 s, but the motion lasts 1 s": lambda: stand_upright(times=(0.5, 9.0)),
    "every weight is zero": lambda: stand_upright(0.0, 0.0),
    "weights of at least 0, got -1": lambda: Objective.of(effort(-1.0), effort(1.0)),
    "weights of at least 0, got nan": lambda: Objective.of(effort(float("nan"))),
    "weights of at least 0, got inf": lambda: Objective.of(effort(float("inf"))),
    "is not finite. Correct the term that causes it": lambda: Objective.of(not_a_number),
    "'many_numbers' must return one number, got (6,)": lambda: Objective.of(many_numbers),
    "J has no finite gradient": lambda: Objective.of(square_root),
    "'failing' failed: KeyError: 'speed'": lambda: Objective.of(failing),
}


@pytest.mark.parametrize("message", sorted(REFUSED_COSTS))
def test_an_objective_that_cannot_be_descended_is_refused_in_one_line(
    message: str, shipped: Emulator
):
    with pytest.raises(ArgumentError) as caught:
        check_objective(REFUSED_COSTS[message](), shipped, np.zeros(6), 20)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_good_objective_is_not_refused(shipped: Emulator):
    def tip_height(trajectory: Trajectory) -> jax.Array:
        return jnp.cos(trajectory.states[-1, 0])

    check_objective(
        Objective.of(*stand_upright(times=(0.5, 1.0)).terms, tip_height), shipped, np.zeros(6), 20
    )


REFUSED_ARGUMENTS = {
    "axes: wanted some of x, y, z, such as 'xy', got 'w'": lambda s: reach_position(
        s, [1.0], within=1, axes="w"
    ),
    "axes: wanted some of x, y, z, such as 'xy', got 'xx'": lambda s: reach_position(
        s, [1, 2], within=1, axes="xx"
    ),
    "wanted rows of 3 finite numbers": lambda s: reach_position(s, [1, 2], within=1),
    "wanted rows of 2 finite numbers": lambda s: reach_positions(
        s, [[1, np.nan]], [1], within=1, axes="xy"
    ),
    "body: none is called 'arm'. Bodies: ": lambda s: reach_point(s, "arm", PLACES[0], within=1),
    "'nose' follows mass points": lambda s: reach_point(
        a_system("fish"), "nose", PLACES[0], within=1
    ),
    "at and since: wanted one of them, got 1.0 and 0.5 s": lambda s: reach_point(
        s, "wheel_fl", PLACES[0], within=1, at=1.0, since=0.5
    ),
    "keyframes: wanted 2 times": lambda s: reach_positions(s, PLACES, [1.0], within=1),
    "keyframes: wanted 2 times of at least 0 s": lambda s: reach_positions(
        s, PLACES, [-1.0, 1.0], within=1
    ),
    "at least two different points": lambda s: follow_path(s, [[0, 0, 0], [0, 0, 0]], within=1),
    "within: wanted a finite number above 0, got 0": lambda s: stand_up(s, within=0),
    "tolerance: wanted a finite number above 0, got -0.1": lambda s: stay_upright(
        s, tolerance=-0.1
    ),
    "since: wanted a time of at least 0 s, got -1": lambda s: stay_upright(s, since=-1.0),
    "distance: wanted a finite number above 0": lambda s: travel(s, [1, 0, 0], -1.0, within=1),
    "body: none is called 'wheel'. Did you mean wheel_rr? Bodies: ": lambda s: travel(
        s, [1, 0, 0], 1.0, within=1, body="wheel"
    ),
    "direction: wanted a direction, got zeros": lambda s: keep_heading(s, [0, 0, 0], within=1),
    "No part called 'elbow'. Parts: root.position": lambda s: stay_within(
        s, "elbow", 0, 1, within=1
    ),
    "wanted low below high for 'steer_fl'": lambda s: stay_within(s, "steer_fl", 1, 0, within=1),
    "wanted a system with a free root or mass points": lambda s: keep_speed(
        a_system("pendulum"), 1, within=1
    ),
}


@pytest.mark.parametrize("message", sorted(REFUSED_ARGUMENTS))
def test_a_cost_that_makes_no_sense_is_refused_in_one_line(message: str):
    with pytest.raises(ArgumentError) as caught:
        REFUSED_ARGUMENTS[message](a_system("truck"))
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


REFUSED_PARAMETERS = {
    "control 1 has 5 and 0": lambda: EachStep.of(10, Bounds((0.0, 5.0), (1.0, 0.0))),
    "control 0 has -inf and 1": lambda: Spline.of(10, 5, Bounds((-np.inf,), (1.0,))),
    "knots: wanted between 4 and the 10 super steps, got 11": lambda: Spline.of(10, 11, BOUNDS),
    "knots: wanted between 4 and the 10 super steps, got 3": lambda: Spline.of(10, 3, BOUNDS),
    "period: wanted more than two super steps of 0.05 s, got 0.1 s": lambda: Periodic.of(
        10, DT, 0.1, BOUNDS
    ),
    "period: wanted more than two super steps of 0.05 s, got nan s": lambda: Periodic.of(
        10, DT, np.nan, BOUNDS
    ),
}


@pytest.mark.parametrize("message", sorted(REFUSED_PARAMETERS))
def test_parameters_that_make_no_sense_are_refused_in_one_line(message: str):
    with pytest.raises(ArgumentError) as caught:
        REFUSED_PARAMETERS[message]()
    assert message in str(caught.value)


def test_bounds_that_cannot_be_kept_are_refused_before_a_descent(shipped: Emulator):
    bounds = Bounds((0.0, 0.0, 2.0), (1.0, 1.0, 1.0))
    with pytest.raises(ArgumentError, match="control 2 has 2 and 1"):
        descend(
            shipped, stand_upright(), np.zeros(6), steps=10, options=DescentOptions(bounds=bounds)
        )
