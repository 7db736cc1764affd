"""Laws of a cloth whose movers turn: turning and moving the world changes nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from soft_bodies import hanging_cloth, hasty_emulator, moving_states

import neuroanimator as na
from neuroanimator.state.rotation import facing, rotate_in_plane

SIDE = 8
"""Number of nodes along an edge of the cloth."""

TOML = """
name = "cape"
kind = "soft"
mesh = "cape.obj"
substeps = 20
shapes = 24
contact_nodes = 16
[physics]
step = 0.0016666666666666668
truth_step = 0.0016666666666666668
fine_step = 0.0008333333333333334
[movers.torso]
position = [0.0, 0.0, 1.0]
turns = true
turn_speed = 4.0
pins = [0, 1, 2, 3, 4, 5, 6, 7]
colliders = [{ radius = 0.1, start = [0.0, -0.15, -0.5], end = [0.0, -0.15, 0.0] }]
[movers.arm]
position = [0.0, 0.4, 0.7]
turns = true
colliders = [{ radius = 0.05, end = [0.3, 0.0, 0.0] }, { box = [0.05, 0.1, 0.05], start = [-0.3, 0.0, 0.0] }]
[movers.ball]
position = [0.3, 0.5, 0.3]
colliders = [{ radius = 0.1 }]
"""


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hanging_cloth(tmp_path_factory.mktemp("cape"), "cape", TOML)


@pytest.fixture(scope="module")
def cape(toml: Path):
    return na.load_system(str(toml))


def elsewhere(cape, states: np.ndarray, shift: np.ndarray, angle: float) -> np.ndarray:
    """Return the same states in a world that is moved, and turned about Z."""
    moved = np.array(states, float)
    for part in cape.state.slices:
        entries = cape.state.index(part.name)
        flat = slice(entries.start, entries.start + 2)
        if part.unit == "rad":
            moved[..., entries] += angle
        elif part.size == 3 and part.unit in ("m", "m/s"):
            turned = np.broadcast_to(angle, (*moved.shape[:-1], 1))
            moved[..., flat] = rotate_in_plane(turned, moved[..., flat])
            if part.unit == "m":
                moved[..., entries] += shift
    return moved


def turned_controls(cape, controls: np.ndarray, angle: float) -> np.ndarray:
    turned = np.array(controls, float)
    for part in cape.control.slices:
        if part.size == 3:
            first = cape.control.index(part.name).start
            flat = slice(first, first + 2)
            angles = np.broadcast_to(angle, (*controls.shape[:-1], 1))
            turned[..., flat] = rotate_in_plane(angles, controls[..., flat])
    return turned


SHIFT = np.array([30.0, -20.0, 10.0])
ANGLE = 2.0


def test_the_state_has_headings_and_their_rates(cape):
    names = [part.name for part in cape.state.slices]
    assert names[:5] == ["arm", "arm_heading", "ball", "torso", "torso_heading"]
    assert names[5:7] == ["arm_velocity", "arm_turning_rate"]
    assert [part.name for part in cape.control.slices][:2] == ["arm", "arm_turning"]
    assert cape.bounds.high[-1] == 4.0


def test_a_state_put_together_and_taken_apart_is_the_same(cape):
    states = moving_states(cape)[5:15]
    motion = cape.motion(states)
    positions, velocities = (np.moveaxis(part, -1, 0) for part in motion[:2])
    size = cape.control.size
    movers, rates = states[:, :size], states[:, size : 2 * size]
    again = cape.encode(positions, velocities, movers, rates, motion.origin.T)
    np.testing.assert_allclose(again, states, atol=2e-3)
    decoded = positions + motion.origin.T[:, None]
    np.testing.assert_allclose(decoded, cape.shapes.decode(states), atol=1e-9)


def test_rates_are_the_derivatives_of_amplitudes(cape):
    """Where the anchor turns, too: all that moves goes on straight, or turns on, for a moment."""
    states = moving_states(cape)[5:15]
    size = cape.control.size
    motion = cape.motion(states)
    step = 1e-6
    rates = states[:, size : 2 * size]
    velocities = np.moveaxis(motion.velocities, -1, 0)
    positions = np.moveaxis(motion.positions + motion.origin, -1, 0)
    now = cape.encode(positions, velocities, states[:, :size], rates)
    moved = states[:, :size] + step * rates
    later = cape.encode(positions + step * velocities, velocities, moved, rates)
    slopes = (later - now)[:, cape.shapes.amplitudes] / step
    count = len(cape.shapes.modes)
    np.testing.assert_allclose(slopes, states[:, -count:], atol=2e-3)


def test_moving_and_turning_the_world_does_not_change_the_physics(cape):
    rng = np.random.default_rng(0)
    starts = moving_states(cape)[20:24]
    controls = cape.sample_paths(rng, 4, 6, 1 / 30, starts)
    here = cape.simulate(starts, controls, 1 / 30).states
    there = cape.simulate(
        elsewhere(cape, starts, SHIFT, ANGLE), turned_controls(cape, controls, ANGLE), 1 / 30
    ).states
    np.testing.assert_allclose(there, elsewhere(cape, here, SHIFT, ANGLE), atol=5e-3)


def test_moving_and_turning_the_world_does_not_change_what_is_shown(cape):
    contacts = cape.structure.shape_contacts
    states = moving_states(cape)[:200]
    controls = cape.sample_paths(np.random.default_rng(1), 200, 1, 1 / 30, states)[:, 0]
    here = np.concatenate(contacts.shown(states, controls, 1 / 30), axis=-1)
    assert here.shape[-1] == contacts.size
    moved = elsewhere(cape, states, SHIFT, ANGLE)
    there = contacts.shown(moved, turned_controls(cape, controls, ANGLE), 1 / 30)
    np.testing.assert_allclose(np.concatenate(there, axis=-1), here, atol=1e-9)
    assert here[:, -4 * len(contacts.nodes) :].any()


def test_a_pin_turns_with_its_mover_along_the_arc(cape):
    controls = np.zeros((1, 8, cape.control.size))
    controls[..., -1] = 3.0
    states = cape.simulate(cape.rest[None], controls, 1 / 30).states[0]
    assert states[-1, cape.state.index("torso_heading")] == pytest.approx(0.8)
    ends = cape.shapes.decode(states[-1])[[0, SIDE - 1]]
    expected = 0.3 * np.array([[-np.cos(0.8), -np.sin(0.8)], [np.cos(0.8), np.sin(0.8)]])
    np.testing.assert_allclose(ends[:, :2], expected, atol=0.02)


def test_paths_come_back_within_reach_and_keep_to_the_speeds(cape):
    rng = np.random.default_rng(3)
    starts = np.repeat(cape.rest[None], 8, axis=0)
    starts[:, :3] += 2.0
    controls = cape.sample_paths(rng, 8, 600, 1 / 30, starts)
    movers = cape.scene.movers
    assert (np.abs(controls) <= movers.speed + 1e-9).all()
    path = starts[:, None, : movers.size] + np.cumsum(controls, axis=1) / 30
    away = np.abs(path - movers.rest)[:, 200:]
    assert (away <= 1.25 * movers.reach + 0.02).all()
    assert (np.abs(controls).max(axis=1) > 0.2 * movers.speed).any()
    assert (np.abs(np.diff(controls, axis=1)) < movers.speed / 2).all()


def test_wind_is_shown_from_where_the_body_heads(toml: Path):
    text = toml.read_text() + "[air]\nwind = [2.0, 0.0, 0.0]\n"
    windy = toml.with_name("windy.toml")
    windy.write_text(text)
    system = na.load_system(str(windy))
    contacts = system.structure.shape_contacts
    state = system.rest.copy()
    state[system.state.index("torso_heading")] = np.pi / 2
    shown = np.concatenate(contacts.shown(state, np.zeros(system.control.size), 1 / 30))
    first = len(shown) - 4 * len(contacts.nodes) - 3
    np.testing.assert_allclose(shown[first : first + 3], [0, -2, 0], atol=1e-9)


@pytest.fixture(scope="module")
def emulator(toml: Path, tmp_path_factory: pytest.TempPathFactory) -> na.Emulator:
    return hasty_emulator(toml, tmp_path_factory.mktemp("trained"))


def test_the_prediction_of_a_turned_world_is_the_turned_prediction(cape, emulator):
    starts = moving_states(cape)[20:23].astype(np.float32)
    controls = cape.sample_paths(np.random.default_rng(2), 3, 5, emulator.dt, starts)
    here = np.asarray(emulator.rollout(starts, controls.astype(np.float32)))
    moved = elsewhere(cape, starts, SHIFT / 10, ANGLE).astype(np.float32)
    turned = turned_controls(cape, controls, ANGLE).astype(np.float32)
    there = np.asarray(emulator.rollout(moved, turned))
    np.testing.assert_allclose(there, elsewhere(cape, here, SHIFT / 10, ANGLE), atol=2e-3)


def test_the_emulator_in_c_is_that_in_jax(cape, emulator):
    starts = moving_states(cape)[20:21].astype(np.float32)
    controls = cape.sample_paths(np.random.default_rng(2), 1, 5, emulator.dt, starts)
    controls = controls.astype(np.float32)
    in_c = np.asarray(emulator.rollout(starts[0], controls[0]))
    state = starts[0]
    for control in controls[0]:
        state = np.asarray(emulator.step(state, control))
    np.testing.assert_allclose(in_c[-1], state, atol=1e-4)


def test_a_cost_of_a_node_follows_the_heading(cape):
    term = na.reach_node(cape, SIDE * SIDE - 1, [0.1, 0.2, 0.3], within=0.5)
    seen = term.observe(moving_states(cape)[:4])
    wanted = cape.shapes.decode(moving_states(cape)[:4], [SIDE * SIDE - 1])[:, 0]
    np.testing.assert_allclose(seen, wanted, atol=1e-5)


def test_the_bones_of_movers_turn_about_where_they_are(cape):
    state = cape.rest.copy()
    state[cape.state.index("arm_heading")] = np.pi / 2
    positions, orientations = cape.skeleton.world_poses(state[None])
    np.testing.assert_allclose(positions[0, 0], [0, 0.4, 0.7], atol=1e-9)
    np.testing.assert_allclose(orientations[0, 0], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-9)


def test_a_path_in_a_turned_world_gives_the_turned_motion(cape, emulator):
    times = np.linspace(0, 1, 31)
    places = np.stack([0.3 * np.sin(times), 0.2 * times, 1 + 0 * times], axis=1)
    headings = 0.8 * times**2
    turned = np.array(places)
    angles = np.full((31, 1), ANGLE)
    turned[:, :2] = rotate_in_plane(angles, places[:, :2])
    here = na.path_drive(
        emulator, {"torso": na.RecordedPath("walk", times, places, facing(headings))}
    )
    there = na.path_drive(
        emulator, {"torso": na.RecordedPath("walk", times, turned, facing(headings + ANGLE))}
    )
    motion = here.motion(emulator)
    np.testing.assert_allclose(motion[:, cape.state.index("torso_heading")][:, 0], headings, atol=1e-4)  # fmt: skip
    expected = elsewhere(cape, motion, np.zeros(3), ANGLE)
    np.testing.assert_allclose(there.motion(emulator), expected, atol=5e-3)
