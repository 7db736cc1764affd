"""Mass points and springs obey the laws of their physics, and move as MuJoCo's do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import combinations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from energies import energy
from jax import Array

from neuroanimator import load_system
from neuroanimator.physics.deformable.body import GRAVITY, Body, Ground
from neuroanimator.physics.deformable.checks import largest_stable_step
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.deformable.mass_spring import (
    STEPPERS,
    BodyState,
    advance,
    implicit_matrix,
    is_inside_out,
    outer_forces,
    spring_stiffness,
    strains,
    trajectory,
)
from neuroanimator.physics.water import Water
from neuroanimator.state.body_frame import Frame
from neuroanimator.systems.system import Scheme

NOWHERE = Water(face_drag=0.0)
"""Water that does nothing but take the weight away."""
SEA = Water(face_drag=60.0, drag=0.3)

QUICK = {"xla_backend_optimization_level": 0}
"""Compiled in half the time."""


@pytest.fixture(autouse=True)
def double_precision() -> Iterator[None]:
    with jax.enable_x64(True):
        yield


@cache
def jelly(water: Water | None = NOWHERE, damping: float = 0.0) -> Body:
    """Return an octahedron of unequal masses, every two of its corners joined; three springs are prompt muscles."""
    rng = np.random.default_rng(0)
    positions = 0.1 * np.array(
        [[2, 0, 0], [-2, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float
    )
    springs = np.array(list(combinations(range(6), 2)))
    muscles = np.zeros((15, 3))
    muscles[[0, 4, 9], [0, 1, 2]] = 0.3
    faces = [[0, 2, 4], [0, 4, 3], [0, 3, 5], [0, 5, 2], [1, 4, 2], [1, 3, 4], [1, 5, 3], [1, 2, 5]]
    return Body(
        names=tuple("abcdef"), positions=positions, masses=rng.uniform(0.05, 0.2, 6), springs=springs,
        stiffness=rng.uniform(30, 60, 15), damping=damping * rng.uniform(0.5, 1.5, 15), muscles=muscles,
        external_forces=np.zeros((3, 3)), faces=np.array([[*face, face[0]] for face in faces]), water=water,
    )  # fmt: skip


def disturbed(body: Body, stretch: float = 0.01, speed: float = 0.3, seed: int = 1) -> BodyState:
    """Return a deformed, turning, drifting motion of `body`, its muscles relaxed."""
    rng = np.random.default_rng(seed)
    positions = body.positions + rng.normal(size=body.positions.shape) * stretch
    return BodyState(
        *map(
            jnp.asarray,
            (positions, rng.normal(size=positions.shape) * speed, np.zeros(body.muscles.shape[1])),
        )
    )


@cache
def stepper(body: Body, integrator: str) -> Callable[[BodyState, Array, float], BodyState]:
    """Return the compiled step (motion, controls, dt) → motion."""
    return jax.jit(partial(STEPPERS[integrator], body), compiler_options=QUICK)


def follow(body: Body, integrator: str, dt: float, steps: int, motion: BodyState) -> BodyState:
    """Return the motion's start and what follows after each step without controls (steps + 1, ...)."""
    step, controls, motions = (
        stepper(body, integrator),
        jnp.zeros(body.external_forces.shape[1]),
        [motion],
    )
    for _ in range(steps):
        motions.append(step(motions[-1], controls, dt))
    return BodyState(
        *(np.stack([np.asarray(part) for part in parts]) for parts in zip(*motions, strict=True))
    )


def reach(
    body: Body, integrator: str, dt: float, seconds: float, motion: BodyState, controls: Array
) -> np.ndarray:
    """Return places and speeds (2, N, 3, ...) after `seconds` of held controls."""
    step = stepper(body, integrator)
    for _ in range(round(seconds / dt)):
        motion = step(motion, controls, dt)
    return np.stack([np.asarray(part) for part in motion[:2]])


def energies_of(body: Body, motions: BodyState) -> np.ndarray:
    """Return the energy of each of the motions (T, ...)."""
    last = BodyState(*(jnp.moveaxis(jnp.asarray(part), 0, -1) for part in motions))
    return np.asarray(jax.jit(partial(energy, body))(last))


@pytest.mark.parametrize("integrator", ["symplectic", "semi-implicit", "rk4"])
def test_without_outer_forces_linear_momentum_stays(integrator: str):
    body = jelly(damping=0.05)
    start = disturbed(body)
    velocities = follow(body, integrator, 0.002, 200, start).velocities
    momenta = np.einsum("n,tnc->tc", body.masses, velocities)
    np.testing.assert_allclose(
        momenta, np.tile(body.masses @ start.velocities, (201, 1)), atol=1e-12
    )
    assert np.abs(velocities - start.velocities).max() > 0.1


def test_without_outer_forces_angular_momentum_stays():
    body = jelly(damping=0.05)
    start = disturbed(body)
    motion = follow(body, "symplectic", 0.002, 200, start)
    momenta = np.einsum("n,tnc->tc", body.masses, np.cross(motion.positions, motion.velocities))
    first = body.masses @ np.cross(start.positions, start.velocities)
    np.testing.assert_allclose(momenta, np.tile(first, (201, 1)), atol=1e-12)
    assert np.abs(first).max() > 1e-3


@pytest.mark.parametrize(("water", "damping"), [(NOWHERE, 0.05), (SEA, 0.0), (None, 0.05)])
def test_energy_never_grows_by_itself(water: Water | None, damping: float):
    body = jelly(water, damping)
    start = disturbed(body)
    motion = follow(body, "rk4", 0.001, 500, start)
    energies = energies_of(body, motion)
    assert np.diff(energies).max() < 1e-9 * energies[0]
    assert energies[-1] < 0.9 * energies[0]


def test_energy_without_friction_stays_for_rk4_and_swings_by_the_step_for_symplectic():
    body = jelly()
    start = disturbed(body)
    swings = {}
    for integrator, dt in (("rk4", 0.001), ("symplectic", 0.002), ("symplectic", 0.001)):
        energies = energies_of(body, follow(body, integrator, dt, round(0.8 / dt), start))
        swings[integrator, dt] = np.abs(energies / energies[0] - 1).max()
    assert swings["rk4", 0.001] < 1e-6
    assert swings["symplectic", 0.002] < 0.1
    assert swings["symplectic", 0.002] / swings["symplectic", 0.001] == pytest.approx(2, rel=0.15)


@pytest.mark.parametrize(
    ("integrator", "water", "dt", "order", "within"),
    [
        ("symplectic", NOWHERE, 0.001, 1, 0.1),
        ("semi-implicit", NOWHERE, 0.001, 1, 0.1),
        ("rk4", NOWHERE, 0.002, 4, 0.15),
        ("rk4", SEA, 0.002, 3, 1.2),
    ],
)
def test_halving_the_step_shows_the_order(
    integrator: str, water: Water, dt: float, order: float, within: float
):
    body = jelly(water, damping=0.05)
    held = jnp.array([1.0, -0.5, 0.3])
    start = disturbed(body)._replace(activations=held)
    coarse, middle, fine = (reach(body, integrator, dt / n, 0.2, start, held) for n in (1, 2, 4))
    found = np.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine))
    assert found == pytest.approx(order, abs=within)


def test_muscles_without_a_response_time_are_there_at_once():
    body, held = jelly(), jnp.array([1.0, -0.5, 0.3])
    start = disturbed(body)
    found = advance(body, "rk4", 0.002, 10, start, held)
    expected = reach(body, "rk4", 0.002, 0.02, start._replace(activations=held), held)
    np.testing.assert_allclose(np.stack(found[:2]), expected, atol=1e-12)
    np.testing.assert_array_equal(found.activations, held)


def test_one_damped_spring_swings_as_its_formula_says():
    axis, masses, stiffness, damping = np.array([1, 2, 2]) / 3, np.array([0.3, 0.5]), 40.0, 0.8
    body = replace(
        jelly(), names=("a", "b"), positions=np.array([[0.0, 0, 0], 0.2 * axis]), masses=masses,
        springs=np.array([[0, 1]]), stiffness=np.array([stiffness]), damping=np.array([damping]),
        muscles=np.zeros((1, 0)), external_forces=np.zeros((3, 1)), faces=np.zeros((0, 4), int),
    )  # fmt: skip
    drift, stretch, parting = np.array([0.1, -0.2, 0.3]), 0.05, 0.4
    middle = masses @ body.positions / masses.sum()
    shares = np.array([-masses[1], masses[0]])[:, None] / masses.sum()
    start = BodyState(
        *map(
            jnp.asarray,
            (body.positions + shares * stretch * axis, drift + shares * parting * axis, []),
        )
    )
    motion = follow(body, "rk4", 0.001, 300, start)
    time = np.arange(301) * 0.001
    reduced = masses.prod() / masses.sum()
    rate = damping / reduced / 2
    frequency = np.sqrt(stiffness / reduced - rate**2)
    swing = np.exp(-rate * time) * (
        stretch * np.cos(frequency * time)
        + (parting + rate * stretch) / frequency * np.sin(frequency * time)
    )
    expected = middle + drift * time[:, None, None] + shares * (0.2 + swing)[:, None, None] * axis
    np.testing.assert_allclose(motion.positions, expected, atol=1e-9)
    assert largest_stable_step(body) == pytest.approx(
        2 / (stiffness / reduced) * (np.sqrt(rate**2 + stiffness / reduced) - rate), rel=1e-9
    )


def test_compression_takes_the_raw_matrix_its_positive_definiteness_but_not_the_clamped_one():
    body, dt = jelly(damping=0.05), 0.01
    assert dt < largest_stable_step(body)
    squeezed = BodyState(
        jnp.asarray(body.positions * 0.1), jnp.asarray(-body.positions), jnp.zeros(3)
    )
    stiffness, _ = spring_stiffness(body, *squeezed)
    assert np.linalg.eigvalsh(implicit_matrix(body, stiffness, dt))[0] < 0
    clamped = np.linalg.eigvalsh(implicit_matrix(body, jnp.maximum(stiffness, 0), dt))
    assert clamped[0] > 0.99 * body.masses.min() / dt
    motion = follow(body, "semi-implicit", dt, 300, squeezed)
    energies = energies_of(body, motion)
    assert np.isfinite(energies).all()
    assert energies.max() < 1.5 * energies[0]
    assert np.abs(strains(body, motion.positions[-1])).max() < 0.2


def mujoco_twin(body: Body) -> mujoco.MjModel:
    """Return the springs of `body` as tendons between bodies that slide along three axes."""

    def triple(numbers):
        return " ".join(repr(float(n)) for n in numbers)

    bodies = "".join(
        f'<body pos="{triple(position)}"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        f'<joint type="slide" axis="0 0 1"/><geom size="0.001" mass="{mass!r}" contype="0" conaffinity="0"/>'
        f'<site name="s{i}"/></body>'
        for i, (position, mass) in enumerate(
            zip(body.positions.tolist(), body.masses.tolist(), strict=True)
        )
    )
    tendons = "".join(
        f'<spatial stiffness="{c!r}" damping="{k!r}" springlength="{length!r}"><site site="s{i}"/><site site="s{j}"/>'
        "</spatial>"
        for (i, j), c, k, length in zip(
            body.springs.tolist(),
            body.stiffness.tolist(),
            body.damping.tolist(),
            body.lengths.tolist(),
            strict=True,
        )
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0"/><worldbody>{bodies}</worldbody><tendon>{tendons}</tendon></mujoco>'
    )


def reach_in_mujoco(
    body: Body, integrator: int, dt: float, seconds: float, motion: BodyState
) -> np.ndarray:
    """Return what `reach` does, by MuJoCo and with the motion's contractions held."""
    model = mujoco_twin(body)
    model.opt.integrator, model.opt.timestep = integrator, dt
    model.tendon_lengthspring[:] = (
        body.lengths * (1 - body.muscles @ np.asarray(motion.activations))
    )[:, None]
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (
        np.ravel(motion.positions - body.positions),
        np.ravel(motion.velocities),
    )
    for _ in range(round(seconds / dt)):
        mujoco.mj_step(model, data)
    return np.stack([body.positions + data.qpos.reshape(-1, 3), data.qvel.reshape(-1, 3)])


def test_mujoco_moves_the_fish_out_of_water_in_the_same_way():
    fish = load_system("fish")
    assert isinstance(fish, DeformableSystem)
    body = replace(fish.body, water=NOWHERE, time_constant=0.0)
    held = jnp.asarray(np.random.default_rng(2).uniform(-1, 1, 12))
    start = disturbed(body, stretch=0.002, speed=0.05)._replace(activations=held)
    euler, rk4 = (
        reach_in_mujoco(body, integrator, 0.002, 0.1, start)
        for integrator in (mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_RK4)
    )
    moved = np.abs(rk4[0] - start.positions).max()
    assert moved > 0.005
    for integrator, other in (("symplectic", euler), ("rk4", rk4)):
        np.testing.assert_allclose(
            reach(body, integrator, 0.002, 0.1, start, held), other, atol=1e-12
        )
    exact = reach_in_mujoco(body, mujoco.mjtIntegrator.mjINT_RK4, 0.0002, 0.1, start)
    for integrator, dt, gain in (("semi-implicit", 0.001, 2), ("rk4", 0.002, 16)):
        off = [
            np.linalg.norm(reach(body, integrator, h, 0.1, start, held)[0] - exact[0])
            for h in (dt, dt / 2)
        ]
        assert off[0] / off[1] == pytest.approx(gain, rel=0.2)


def test_the_gradient_through_a_motion_is_that_of_finite_differences():
    body = jelly(SEA, damping=0.05)
    start, rng = disturbed(body), np.random.default_rng(3)
    controls, direction = (jnp.asarray(rng.uniform(-0.8, 0.8, (5, 3))) for _ in range(2))

    def swum(scale: Array) -> Array:
        motion = start._replace(velocities=start.velocities * (1 + scale))
        path = trajectory(body, "symplectic", 0.002, 20, motion, controls + scale * direction)
        return jnp.sum(path.positions[-1] ** 2) + path.positions[-1, 0, 0]

    both, step = jax.jit(jax.value_and_grad(swum), compiler_options=QUICK), 1e-5
    slope = float(both(0.0)[1])
    assert slope == pytest.approx(float(both(step)[0] - both(-step)[0]) / (2 * step), rel=1e-6)
    assert abs(slope) > 1e-3


@pytest.mark.parametrize("integrator", ["symplectic", "semi-implicit", "rk4"])
def test_bodies_side_by_side_move_as_each_alone(integrator: str):
    body = replace(
        jelly(Water(face_drag=60.0, surface=0.0), 0.05), ground=Ground(500.0, 0.1, 0.5, 0.05)
    )
    motions = [disturbed(body, seed=seed) for seed in range(3)]
    held = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (3, 3)))
    together = BodyState(*(jnp.stack(parts, axis=-1) for parts in zip(*motions, strict=True)))
    found = reach(body, integrator, 0.002, 0.1, together, held)
    for row, motion in enumerate(motions):
        alone = reach(body, integrator, 0.002, 0.1, motion, held[:, row])
        np.testing.assert_allclose(found[..., row], alone, atol=1e-12)


@pytest.mark.parametrize("corners", [[0, 2, 3, 4], [0, 2, 4, 0]])
def test_water_brakes_a_face_that_moves_outward_and_lets_go_of_one_that_moves_inward(
    corners: list[int],
):
    positions = jelly().positions.copy()
    positions[:, 2] = 0.0
    positions[[0, 2, 3, 4], :2] = np.array([[0, 0], [0.2, 0], [0.2, 0.3], [0, 0.3]])
    body = replace(jelly(Water(face_drag=50.0)), faces=np.array([corners]), positions=positions)
    area = 0.06 if len(set(corners)) == 4 else 0.03

    forces = jax.jit(partial(outer_forces, body), compiler_options=QUICK)

    def push(velocity: list[float]) -> np.ndarray:
        motion = BodyState(
            jnp.asarray(positions), jnp.tile(jnp.asarray(velocity), (6, 1)), jnp.zeros(3)
        )
        return np.asarray(forces(motion, jnp.zeros(3)))

    outward = push([0.3, -0.1, 0.4])
    np.testing.assert_allclose(outward.sum(axis=0), [0, 0, -50 * area * 0.4], atol=1e-12)
    np.testing.assert_allclose(outward[np.unique(corners), 2], outward[0, 2])
    assert np.abs(push([0.3, -0.1, -0.4])).max() == 0
    assert np.abs(push([0.3, -0.1, 0.0])).max() == 0


def test_a_body_of_waters_weight_hangs_below_the_surface_and_falls_above_it():
    body = jelly(Water(face_drag=0.0, buoyancy=1.0, surface=2.0, depth=0.1))
    for height, fall in ((0.0, 0.0), (10.0, GRAVITY / 2)):
        start = BodyState(
            jnp.asarray(body.positions + np.array([0, 0, height])),
            jnp.zeros_like(body.positions),
            jnp.zeros(3),
        )
        after = reach(body, "rk4", 0.002, 1.0, start, jnp.zeros(3))[0]
        np.testing.assert_allclose(
            after - start.positions, np.tile([0, 0, -fall], (6, 1)), atol=1e-9
        )


def test_a_light_body_rises_and_comes_to_float():
    body = replace(
        jelly(damping=1.0),
        water=Water(face_drag=0.0, drag=4.0, buoyancy=2.0, surface=0.0, depth=0.3),
    )
    start = BodyState(
        jnp.asarray(body.positions - np.array([0, 0, 1.0])),
        jnp.zeros_like(body.positions),
        jnp.zeros(3),
    )
    positions = follow(body, "symplectic", 0.005, 1600, start).positions
    heights = positions[:, :, 2] @ body.masses / body.masses.sum()
    assert heights[80] > -0.9
    assert heights[-1] == pytest.approx(0.0, abs=0.01)
    assert heights[-200] == pytest.approx(heights[-1], abs=0.001)


@pytest.mark.parametrize("name", ["fish", "dolphin"])
def test_what_is_mirrored_moves_in_the_mirror(name: str):
    system, rng = load_system(name), np.random.default_rng(4)
    assert isinstance(system, DeformableSystem)
    mirror = system.structure.mirror
    assert mirror is not None

    def reflect(states: np.ndarray) -> np.ndarray:
        positions, velocities, activations = system.unpack(states)
        seen = (
            part[..., list(mirror.points), :] * [1.0, -1.0, 1.0] for part in (positions, velocities)
        )
        return system.pack(*seen, activations[..., list(mirror.controls)])

    starts = system.sample_starts(rng, 8)
    controls = rng.uniform(-1, 1, (8, 6, system.control.size))
    path, other = (
        system.simulate(*given, 0.1, scheme=system.scheme).states
        for given in ((starts, controls), (reflect(starts), controls[..., list(mirror.controls)]))
    )
    np.testing.assert_allclose(other, reflect(path), atol=1e-9)
    assert np.abs(other - path).max() > 0.01
    before, after = system.unpack(path[:, :-1])[2], system.unpack(path[:, 1:])[2]
    kept = np.exp(-0.1 / system.body.time_constant)
    np.testing.assert_allclose(after, controls + (before - controls) * kept, atol=1e-12)


@pytest.mark.parametrize("integrator", ["symplectic", "semi-implicit"])
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_the_largest_step_is_just_where_small_vibrations_begin_to_grow(
    integrator: str, damping: float
):
    body = jelly(damping=damping)
    start = disturbed(body, stretch=1e-7, speed=0.0)
    for share, is_bounded in ((0.99, True), (1.01, False)):
        positions = follow(
            body, integrator, share * largest_stable_step(body), 500, start
        ).positions
        off = np.abs(np.asarray(positions) - body.positions).max()
        assert (off < 1e-5) if is_bounded else (off > 1e-3 or not np.isfinite(off)), (share, off)


def test_a_body_is_inside_out_in_a_mirror_or_with_its_tail_pushed_through_itself():
    fish = load_system("fishes")
    assert isinstance(fish, DeformableSystem)
    long = fish.at(length=0.338)
    positions = long.unpack(long.rest)[0]
    strained = positions[:, [1, 2, 0]] * (1.3, 0.8, 1.1) + 2.0
    pushed = positions.copy()
    tail = [fish.body.names.index(name) for name in ("tail_up", "tail_down")]
    pushed[tail, 0] += 0.15
    assert not is_inside_out(fish.body, strained)
    assert is_inside_out(fish.body, -strained)
    assert is_inside_out(fish.body, pushed)
    path = np.tile(long.rest, (7, 1))
    passing = path.copy()
    passing[2:4, : pushed.size] = pushed.ravel()
    stuck = path.copy()
    stuck[2:, : pushed.size] = pushed.ravel()
    runs = np.stack([path, passing, stuck])
    assert long.has_diverged(runs).tolist() == [False, False, True]
    assert load_system("fish").has_diverged(runs[..., : fish.state.size - 3]).tolist() == [
        False,
        False,
        True,
    ]


def test_the_cube_dropped_from_a_metre_bounces_two_to_four_times_and_comes_to_rest():
    cube = load_system("cube")
    assert isinstance(cube, DeformableSystem)
    start = cube.rest + cube.pack(np.tile([0.0, 0.0, 1.0], (8, 1)), np.zeros((8, 3)), np.zeros(0))
    path = cube.simulate(
        start[None], np.zeros((1, 600, 3)), 0.01, scheme=Scheme("symplectic", 0.002)
    )
    assert not path.has_diverged.any()
    positions, velocities, _ = cube.unpack(path.states[0])
    is_up = positions[:, :, 2].min(axis=1) > 0.002
    assert 2 <= np.sum(is_up[1:] & ~is_up[:-1]) <= 4
    assert np.ptp(positions[:, :, 2], axis=1).min() < 0.25
    assert np.abs(velocities[-1]).max() < 0.01
    np.testing.assert_allclose(positions[-1], cube.body.positions, atol=0.01)


@pytest.mark.parametrize(
    "name", ["cube", pytest.param("dolphin", marks=pytest.mark.endurance), "fish"]
)
def test_the_truth_is_close_to_the_fine_reference(name: str):
    system, rng = load_system(name), np.random.default_rng(1)
    starts = system.sample_starts(rng, 60)
    controls = rng.uniform(-1, 1, (60, 1, system.control.size))
    exact, found = (
        system.simulate(starts, controls, 0.1, scheme=scheme).states[:, 1]
        for scheme in (system.fine, system.truth)
    )
    frame = Frame.of(system.structure, 0.1)
    unit = frame.difference(starts, exact).std(axis=0)
    assert np.sqrt(np.mean((frame.difference(exact, found) / unit) ** 2)) < 0.003


def test_a_body_loaded_again_moves_without_being_compiled_again(caplog: pytest.LogCaptureFixture):
    was_compiled = []
    for _ in range(2):
        cube = load_system("cube")
        caplog.clear()
        with jax.log_compiles():
            cube.simulate(
                cube.rest[None], np.zeros((1, 3, 3)), 0.006, scheme=Scheme("symplectic", 0.002)
            )
        was_compiled.append("Compiling" in caplog.text)
    assert was_compiled == [True, False]
