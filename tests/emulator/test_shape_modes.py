"""Emulators of deformable bodies: few numbers, a frame of their own, left and right alike, networks in a hierarchy."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import Emulator, TrainingConfig, load_system
from neuroanimator.definitions.body import BodyDefinition
from neuroanimator.emulator.mode_fitting import fit_modes
from neuroanimator.emulator.networks.hierarchy import Hierarchy, check_parts
from neuroanimator.emulator.networks.network import NetworkShape, Part
from neuroanimator.emulator.pca import reflection
from neuroanimator.errors import ArgumentError
from neuroanimator.learn.data.config import DatasetConfig
from neuroanimator.learn.data.generate import simulate_transitions
from neuroanimator.learn.data.store import Transitions
from neuroanimator.learn.training.initialise import build_emulator
from neuroanimator.learn.training.train import train
from neuroanimator.physics.deformable.deformable_system import DeformableSystem
from neuroanimator.physics.loading import resolve
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.reference_shape import flat_of, points_of
from neuroanimator.state.rotation import rotate, to_world_axes

FLAT = {"widths": (16, 8), "position_modes": 12, "velocity_modes": 14}
DEEP = {"network": "hierarchy", "widths": (16, 0, 8), "local_modes": 3}


@cache
def few(system: str) -> Transitions:
    config = DatasetConfig(system=system, count=360, samples_per_run=36)
    return simulate_transitions(config)


@pytest.fixture(params=["fish", pytest.param("dolphin", marks=pytest.mark.endurance)])
def data(request) -> Transitions:
    return few(request.param)


@pytest.fixture
def fish() -> Transitions:
    return few("fish")


@pytest.fixture
def cube() -> Transitions:
    return few("cube")


@pytest.fixture(
    params=[
        pytest.param(("fish", FLAT), id="fish"),
        pytest.param(("fish", DEEP), id="hierarchy"),
        pytest.param(("dolphin", FLAT), id="dolphin", marks=pytest.mark.endurance),
    ]
)
def case(request) -> tuple[Transitions, Emulator]:
    name, settings = request.param
    return few(name), fresh(name, TrainingConfig(**settings))


@cache
def fresh(system: str, config: TrainingConfig) -> Emulator:
    """Return an emulator that has learnt nothing yet, the same one for every test."""
    return build_emulator(few(system), config)


def windows(data: Transitions) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(data.states[:20, 0], float), np.asarray(data.controls[:20, 0], float)


def turned(
    data: Transitions, states: np.ndarray, orientation: np.ndarray, way: np.ndarray | float
) -> np.ndarray:
    size = 3 * len(data.system.structure.cloud.masses)
    positions, velocities = (
        rotate(orientation, points_of(states[:, i * size : (i + 1) * size])) for i in range(2)
    )
    return np.concatenate(
        [flat_of(positions + way), flat_of(velocities), states[:, 2 * size :]], axis=1
    )


def test_all_modes_together_lose_nothing(data: Transitions):
    states, _ = windows(data)
    modes = fit_modes(data.system.structure, data.states[:, 0], 69, 69)
    assert np.abs(modes.decode(modes.encode(states)) - states).max() < 1e-5 * np.abs(states).max()


def test_encoding_what_was_decoded_changes_nothing(data: Transitions):
    states, _ = windows(data)
    modes = fit_modes(data.system.structure, data.states[:, 0], 12, 12)
    once = modes.decode(modes.encode(states))
    assert np.abs(modes.decode(modes.encode(once)) - once).max() < 1e-2 * np.abs(once).max()


def test_moving_and_turning_the_world_changes_nothing(case: tuple[Transitions, Emulator]):
    data, emulator = case
    states, controls = windows(data)
    orientation = (
        np.array([0.8, 0.3, -0.4, 0.33])
        if not data.system.structure.has_gravity
        else np.array([0.6, 0, 0, 0.8])
    )
    orientation, way = orientation / np.linalg.norm(orientation), np.array([0.7, -0.4, 0.0])
    step = jax.jit(jax.vmap(emulator.step))
    with jax.enable_x64(True):
        here = np.asarray(step(states, controls))
        there = np.asarray(step(turned(data, states, orientation, way), controls))
    assert np.abs(turned(data, here, orientation, way) - there).max() < 1e-5


def test_turning_the_world_turns_pushes_too(cube: Transitions):
    emulator = build_emulator(
        cube, TrainingConfig(widths=(16, 8), position_modes=18, velocity_modes=18)
    )
    states, controls = (np.asarray(part, float) for part in windows(cube))
    orientation = np.array([0.6, 0, 0, 0.8])
    pushed = rotate(np.broadcast_to(orientation, (len(controls), 4)), controls)
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), emulator)  # no last bits
        step = jax.jit(jax.vmap(exact.step))
        here, there = (
            np.asarray(step(states, controls)),
            np.asarray(step(turned(cube, states, orientation, 0), pushed)),
        )
    assert np.abs(turned(cube, here, orientation, 0) - there).max() < 1e-10


def test_left_and_right_are_the_same_exactly(case: tuple[Transitions, Emulator]):
    data, emulator = case
    states, controls = windows(data)
    mirror = data.system.structure.mirror
    flip, size, partners = reflection(mirror), 3 * len(mirror.points), list(mirror.controls)

    def image(s: np.ndarray) -> np.ndarray:
        parts = s[:, :size] @ flip.T, s[:, size : 2 * size] @ flip.T, s[:, 2 * size :][:, partners]
        return np.concatenate(parts, axis=1)

    step = jax.jit(jax.vmap(emulator.step))
    here, there = (
        np.asarray(step(states, controls)),
        np.asarray(step(image(states), controls[:, partners])),
    )
    assert np.abs(image(here) - there).max() < 2e-5 * max(1, np.abs(here).max())


def test_muscles_follow_their_controls_exactly(case: tuple[Transitions, Emulator]):
    data, emulator = case
    states, controls = windows(data)
    muscles = data.system.muscles
    found = np.asarray(jax.jit(jax.vmap(emulator.step))(states, controls))[:, -muscles:]
    assert np.abs(found - data.states[:20, 1, -muscles:]).max() < 1e-5


def test_a_rollout_is_repeated_steps_of_a_decoded_body(case: tuple[Transitions, Emulator]):
    data, emulator = case
    path = emulator.rollout(data.states[0, 0], data.controls[0])
    latent = eqx.filter_jit(emulator.encode)(jnp.asarray(data.states[0, 0]))
    advance = eqx.filter_jit(emulator.step_latent)
    decode = eqx.filter_jit(emulator.decode)
    for control, state in zip(data.controls[0], np.asarray(path[1:]), strict=True):
        latent = advance(latent, emulator.encode_control(control))
        assert np.abs(np.asarray(decode(latent)) - state).max() < 1e-5 * max(1, np.abs(state).max())


def test_the_gradient_of_a_motion_equals_finite_differences(case: tuple[Transitions, Emulator]):
    data, emulator = case
    controls = 0.7 * np.asarray(
        data.controls[0], float
    )  # well within what was seen: clipping has kinks
    way = np.random.default_rng(0).normal(size=controls.shape)
    with jax.enable_x64(True):
        double = jax.tree.map(
            lambda leaf: jnp.asarray(np.asarray(leaf, float)) if eqx.is_array(leaf) else leaf,
            emulator,
        )
        latent = double.encode(np.asarray(data.states[0, 0], float))

        def reach(controls):
            def step(state, control):
                return double.step_latent(state, control), None

            state, _ = jax.lax.scan(step, jnp.asarray(latent), double.encode_control(controls))
            return double.decode(state)[0]

        slope = np.vdot(jax.jit(jax.grad(reach))(controls), way)
        value = jax.jit(reach)
        ends = [value(controls + sign * 1e-6 * way) for sign in (1, -1)]
    assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / 2e-6, rel=1e-4, abs=1e-9)


def test_saving_and_loading_changes_no_bit(case: tuple[Transitions, Emulator], tmp_path: Path):
    data, emulator = case
    emulator.save(tmp_path / "a.safetensors")
    again = Emulator.load(tmp_path / "a.safetensors")
    again.save(tmp_path / "b.safetensors")
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    here, there = (each.rollout(data.states[0, 0], data.controls[0]) for each in (emulator, again))
    assert np.array_equal(here, there)


def test_the_frame_of_a_body_wobbles_least(data: Transitions):
    """Eckart's frame: no other turn brings the body at rest closer."""
    states, _ = windows(data)
    cloud = data.system.structure.cloud
    positions = points_of(states[:, : 3 * cloud.count])
    centred, shares = (
        positions - cloud.centroid(positions)[:, None],
        np.array(cloud.masses)[:, None],
    )

    def apart(orientations: np.ndarray) -> np.ndarray:
        turned = rotate(orientations[:, None], np.array(cloud.positions))
        return np.sum(shares * (centred - turned) ** 2, axis=(1, 2))

    best = cloud.orientation(positions)
    rng = np.random.default_rng(0)
    for _ in range(10):
        other = best + 0.02 * rng.normal(size=best.shape)
        assert (
            apart(other / np.linalg.norm(other, axis=1, keepdims=True)) >= apart(best) - 1e-12
        ).all()


def test_a_body_seen_in_its_own_frame_is_the_same_wherever_it_is_and_is_found_there_again(
    data: Transitions,
):
    states, _ = windows(data)
    cloud = data.system.structure.cloud
    positions = points_of(states[:, : 3 * cloud.count])
    centre, orientation, seen = cloud.own_frame(positions)
    size = np.abs(seen).max()
    assert (
        np.abs(centre[:, None] + to_world_axes(orientation, seen) - positions).max() < 1e-12 * size
    )
    elsewhere = rotate(np.array([0.8, 0.0, -0.48, 0.36]), positions) + np.array([0.7, -0.4, 0.2])
    assert np.abs(cloud.own_frame(elsewhere)[2] - seen).max() < 1e-9 * size
    assert np.abs(seen - positions).max() > 1e-3 * size  # they were somewhere else, or turned


def test_a_change_is_put_back_where_it_was_seen(data: Transitions):
    states, _ = windows(data)
    frame = Frame.of(data.system.structure, 0.1)
    following = np.asarray(data.states[:20, 1], float)
    again = frame.apply(states, frame.remainder(states, following))
    size = 2 * 3 * len(data.system.structure.cloud.masses)
    assert np.abs(again - following)[:, :size].max() < 1e-9 * max(1, np.abs(states).max())


def test_repeated_parts_share_weights():
    """Two segments that are alike use one network: half the weights, and the same answers for the same sight."""
    upper = Part("body", (0,), (), (0,))
    legs = [
        Part("left", (1,), (), (1,), hears=(0,)),
        Part("right", (2,), (), (2,), hears=(0,), like=0),
    ]
    key = jax.random.key(0)
    network = Hierarchy.of(NetworkShape(3, 0, 3, (4, 0, 4), parts=(upper, *legs)), key=key)
    assert network.children.linear.shape[0] == 1
    answer = eqx.filter_jit(network)
    answers = np.asarray(answer(np.float32([0.3, 0.7, 0.7]), np.zeros(0, np.float32)))
    assert answers[1] == answers[2]
    other = np.asarray(answer(np.float32([0.3, 0.7, -0.2]), np.zeros(0, np.float32)))
    assert answers[1] == other[1]
    assert answers[2] != other[2]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda parts: parts[:-1], "every number"),
        (
            lambda parts: (*parts[:-1], replace(parts[-1], odd=(999,))),
            "refers to an input that does not exist",
        ),
        (
            lambda parts: (*parts[:-1], replace(parts[-1], hears=(999,))),
            "refers to an input that does not exist",
        ),
        (lambda parts: (*parts[:-1], replace(parts[-1], like=7)), "weights of part 7"),
    ],
)
def test_parts_that_do_not_fit_are_refused(fish: Transitions, change, word: str):
    emulator = build_emulator(fish, TrainingConfig(**DEEP))
    sizes = emulator.features.sizes(
        emulator.normaliser.plain_mean.shape[0] - len(emulator.features.plain)
    )
    with pytest.raises(ArgumentError, match=word):
        check_parts(
            change(emulator.network.parts), *sizes, emulator.normaliser.unit.shape[0], (16, 0, 8)
        )


def test_a_hierarchy_needs_groups():
    data = simulate_transitions(DatasetConfig(system="pendulum", count=120))
    with pytest.raises(ArgumentError, match="no \\[groups\\]"):
        build_emulator(data, TrainingConfig(network="hierarchy"))


@pytest.mark.endurance
def test_the_tutorials_body_is_learnt(tmp_path: Path):
    """Half a minute of a soft worm, and the change in a super step is known to a quarter."""
    page = (Path(__file__).parents[2] / "docs/tutorials/my-body.md").read_text()
    (tmp_path / "worm.toml").write_text(page.partition("```toml\n")[2].partition("```")[0])
    name, text, _ = resolve(str(tmp_path / "worm.toml"))
    data = simulate_transitions(
        DatasetConfig(system=name, definition=text, count=2400, samples_per_run=24)
    )
    errors: list[float] = []
    config = TrainingConfig(updates=750, widths=(16,), batch=128)
    train(
        data,
        config,
        tmp_path / "worm.emulator.safetensors",
        on_report=lambda report: errors.append(report.error),
    )
    assert errors[-1] < 0.25


def test_what_is_righted_knows_up_and_what_only_hovers_in_water_does_not():
    assert load_system("dolphin").structure.has_gravity
    assert load_system("fish").structure.has_gravity
    values = tomllib.loads(
        (resources.files("neuroanimator.systems") / "assets" / "fish.toml").read_text("utf-8")
    )
    values["water"]["righting"] = 0.0
    assert not DeformableSystem(BodyDefinition.model_validate(values)).structure.has_gravity
