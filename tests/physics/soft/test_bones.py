"""Laws of a soft body among movers that turn freely, as bones do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from soft_bodies import hanging_cloth, hasty_emulator, moving_states

import neuroanimator as na
from neuroanimator.animation.motion import random_drive
from neuroanimator.animation.path_drive import movers_of
from neuroanimator.animation.recorded_path import paths_of_nodes
from neuroanimator.errors import ArgumentError, NeuroAnimatorError
from neuroanimator.export.garment import wear
from neuroanimator.files.glb import read_glb
from neuroanimator.physics.soft.program import SoftProgram
from neuroanimator.state.mover_poses import change_between, moved
from neuroanimator.state.rotation import (
    multiply,
    of_unit_length,
    rotate,
    rotated_by,
    rotation_between,
)
from neuroanimator.state.segments import Driven, segments_from_json, segments_to_json
from neuroanimator_studio.opening import wander

DT = 1 / 30

TOML = """
name = "wrap"
kind = "soft"
mesh = "wrap.obj"
substeps = 20
shapes = 24
contact_nodes = 16
[physics]
step = 0.0016666666666666668
truth_step = 0.0016666666666666668
fine_step = 0.0008333333333333334
[movers.chest]
position = [0.0, 0.0, 1.0]
turns = "freely"
turn_speed = [3.0, 3.0, 3.0]
turn_reach = [0.6, 0.3, 0.6]
pins = [0, 1, 2, 3, 4, 5, 6, 7]
colliders = [{ radius = 0.1, start = [0.0, -0.15, -0.5], end = [0.0, -0.15, 0.0] }]
[movers.arm]
position = [0.0, 0.4, 0.7]
turns = "freely"
turn_speed = 4.0
reach = [0.2, 0.4, 0.2]
colliders = [{ radius = 0.05, end = [0.3, 0.0, 0.0] }, { box = [0.05, 0.1, 0.05], start = [-0.3, 0.0, 0.0] }]
"""

TURN = of_unit_length(np.array([0.8, 0.3, -0.4, 0.2]))
"""A rotation about a slanting axis."""

SHIFT = np.array([3.0, -2.0, 5.0])


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hanging_cloth(tmp_path_factory.mktemp("wrap"), "wrap", TOML)


@pytest.fixture(scope="module")
def wrap(toml: Path):
    return na.load_system(str(toml))


@pytest.fixture(scope="module")
def emulator(toml: Path, tmp_path_factory: pytest.TempPathFactory) -> na.Emulator:
    return hasty_emulator(toml, tmp_path_factory.mktemp("trained"))


def test_poses_and_their_changes_go_round():
    rng = np.random.default_rng(0)
    quaternions = (3, 11)
    before, after = rng.normal(size=(2, 5, 16))
    for poses in (before, after):
        for first in quaternions:
            poses[:, first : first + 4] = of_unit_length(poses[:, first : first + 4])
    change = change_between(before, after, quaternions)
    assert change.shape == (5, 14)
    again = moved(before, change, quaternions)
    for first in quaternions:
        entries = slice(first, first + 4)
        sign = np.sign((again[:, entries] * after[:, entries]).sum(axis=1, keepdims=True))
        again[:, entries] *= sign
    np.testing.assert_allclose(again, after, atol=1e-9)


def test_a_driven_segment_survives_its_file():
    segment = Driven(size=16, quaternions=(3, 11))
    (again,) = segments_from_json(json.loads(json.dumps(segments_to_json((segment,)))))
    assert again == segment
    assert again.followed == 14
    for faulty in ([3, 5], [13], ["x"], 3):
        with pytest.raises(ValueError, match="segment: quaternions"):
            segments_from_json([["driven", 16, -1, 0.0, faulty]])


def test_the_state_has_orientations_and_angular_velocities(wrap):
    names = [part.name for part in wrap.state.slices]
    assert names[:4] == ["arm", "arm_orientation", "chest", "chest_orientation"]
    assert names[4:6] == ["arm_velocity", "arm_angular_velocity"]
    assert [(part.name, part.size) for part in wrap.control.slices][:2] == [
        ("arm", 3),
        ("arm_turning", 3),
    ]
    assert wrap.bounds.high[3:6] == (4.0, 4.0, 4.0)
    assert wrap.state.index("shapes").start == 14 + 12


def taken_apart(wrap, states: np.ndarray) -> np.ndarray:
    motion = wrap.motion(states)
    positions, velocities = (np.moveaxis(part, -1, 0) for part in motion[:2])
    return wrap.encode(positions, velocities, states[:, :14], states[:, 14:26], motion.origin.T)


def test_a_state_put_together_and_taken_apart_is_the_same(wrap):
    states = moving_states(wrap)[5:15]
    assert np.abs(states[:, wrap.state.index("chest_angular_velocity")]).max() > 0.1
    np.testing.assert_allclose(taken_apart(wrap, states), states, atol=2e-3)
    positions = np.moveaxis(wrap.motion(states).positions, -1, 0)
    origins = states[:, None, wrap.state.index("chest")]
    np.testing.assert_allclose(positions + origins, wrap.shapes.decode(states), atol=1e-9)


def test_rates_are_the_derivatives_of_amplitudes(wrap):
    """While the anchor turns, too: all that moves goes on straight, or turns on, for a moment."""
    states = moving_states(wrap)[5:15]
    motion = wrap.motion(states)
    step = 1e-6
    poses, rates = states[:, :14], states[:, 14:26]
    velocities = np.moveaxis(motion.velocities, -1, 0)
    positions = np.moveaxis(motion.positions + motion.origin, -1, 0)
    now = wrap.encode(positions, velocities, poses, rates)
    later_poses = wrap.scene.movers.moved(poses, step * rates)
    later = wrap.encode(positions + step * velocities, velocities, later_poses, rates)
    slopes = (later - now)[:, wrap.shapes.amplitudes] / step
    count = len(wrap.shapes.modes)
    np.testing.assert_allclose(slopes, states[:, -count:], atol=2e-3)


def test_a_bone_turns_evenly_and_exactly(wrap):
    """Pinned nodes go where the bone's rates say, at the middle of a frame as at its end."""
    movers = wrap.scene.movers
    rates = np.zeros((1, 1, 12))
    rates[..., 6:] = [0.3, -0.2, 0.1, 2.0, -1.0, 1.5]
    paths = movers.paths(movers.rest[None], rates, DT)
    chest = movers.places[1]
    turned = chest.placement.quaternions(paths[0, 1])
    np.testing.assert_allclose(rotation_between(wrap.rest[10:14], turned), DT * rates[0, 0, 9:])
    body = wrap.scene.body
    rest = wrap.motion(wrap.rest[None])
    start = (rest.positions + rest.origin)[..., 0]
    halves = movers.paths(movers.rest[None], np.repeat(rates, 2, axis=1), DT / 2)
    for poses in (paths[0], halves[0]):
        played, _ = SoftProgram(body, dtype=np.float64).play(
            start, np.zeros_like(start), movers.poses(poses, np.zeros(3)), DT, 20
        )
        place = chest.placement
        held = place.to_world(poses[-1], body.held)
        np.testing.assert_allclose(played[-1][body.pins], held, atol=1e-9)


def elsewhere(wrap, states: np.ndarray) -> np.ndarray:
    """Return the same states in a world that is moved, and turned about a slanting axis."""
    there = np.array(states, float)
    turn = np.broadcast_to(TURN, (*states.shape[:-1], 4))
    for part in wrap.state.slices:
        entries = wrap.state.index(part.name)
        if part.unit == "quaternion":
            there[..., entries] = multiply(turn, there[..., entries])
        elif part.size == 3 and part.unit in ("m", "m/s"):
            there[..., entries] = rotate(turn, there[..., entries])
            if part.unit == "m":
                there[..., entries] += SHIFT
    return there


def turned_controls(controls: np.ndarray) -> np.ndarray:
    turned = np.array(controls)
    turn = np.broadcast_to(TURN, (*controls.shape[:-1], 4))
    for first in (0, 6):
        turned[..., first : first + 3] = rotate(turn, controls[..., first : first + 3])
    return turned


def test_turning_the_world_changes_no_contact(wrap):
    """Colliders, boxes among them, are where their bones are; only the vertical tells how the world is turned."""
    states = moving_states(wrap)[5:15]
    contacts = wrap.structure.shape_contacts
    here, there = (contacts.distances(where) for where in (states, elsewhere(wrap, states)))
    for before, after in zip(here, there, strict=True):
        np.testing.assert_allclose(after, before, atol=1e-9)
    controls = np.random.default_rng(0).normal(size=(10, 12))
    shown = np.concatenate(contacts.shown(states, controls, DT), axis=-1)
    again = contacts.shown(elsewhere(wrap, states), turned_controls(controls), DT)
    assert shown.shape[1] == contacts.size
    changed = np.abs(np.concatenate(again, axis=-1) - shown).max(axis=0) > 1e-9
    assert changed.sum() == 3


def test_without_gravity_the_physics_does_not_know_how_the_world_is_turned(wrap, monkeypatch):
    monkeypatch.setattr("neuroanimator.physics.soft.program.GRAVITY", (0.0, 0.0, 0.0))
    starts = moving_states(wrap)[20:24]
    controls = wrap.sample_paths(np.random.default_rng(0), 4, 6, DT, starts)
    here = wrap.simulate(starts, controls, DT).states
    there = wrap.simulate(elsewhere(wrap, starts), turned_controls(controls), DT).states
    np.testing.assert_allclose(there, elsewhere(wrap, here), atol=5e-3)


def test_a_bone_is_seen_by_its_nearness_alone(wrap):
    """Of fourteen bones a network could not tell what matters."""
    contacts = wrap.structure.shape_contacts
    of_chest, up = 6, 3
    assert contacts.size == 2 * of_chest + up + 4 * len(contacts.nodes)


def test_the_emulator_knows_the_bones_exactly_and_survives_its_file(wrap, emulator, tmp_path):
    start = moving_states(wrap)[30]
    controls = wrap.sample_paths(np.random.default_rng(2), 1, 12, DT, start[None])[0]
    states = np.asarray(emulator.rollout(start, controls))
    paths = wrap.scene.movers.paths(start[None, :14], controls[None], DT)[0]
    np.testing.assert_allclose(states[:, :14], paths, atol=1e-5)
    np.testing.assert_allclose(states[1:, 14:26], controls, atol=1e-6)
    state = start.astype(np.float32)
    for control in controls.astype(np.float32):
        state = np.asarray(emulator.step(state, control))
    np.testing.assert_allclose(states[-1], state, atol=1e-4)  # in C, as in JAX
    file = tmp_path / "wrap.emulator.safetensors"
    emulator.save(file)
    again = na.Emulator.load(file)
    np.testing.assert_array_equal(np.asarray(again.rollout(start, controls)), states)


def test_a_random_motion_keeps_to_the_bounds_and_turns(emulator):
    drive = random_drive(emulator, 2.0, 1)
    assert drive.controls.shape[1] == 12
    assert emulator.bounds.contain(drive.controls)
    assert np.abs(drive.controls[:, 9:]).max() > 0.1


def test_what_the_studio_shows_ends_where_it_began(emulator):
    drive = wander(emulator)
    states = np.asarray(emulator.rollout(drive.start, drive.controls))
    assert np.abs(states[:, 3:7] - states[0, 3:7]).max() > 0.05
    np.testing.assert_allclose(states[-1, :14], states[0, :14], atol=1e-3)


def test_a_path_tilts_what_turns_freely(emulator):
    """And only that: a remark says what another mover cannot follow."""
    times = np.linspace(0, 1, 31)
    leaning = np.stack([0 * times, 0.8 + 0.5 * times**2, 0 * times], axis=1)
    orientations = rotated_by(np.tile([1.0, 0, 0, 0], (31, 1)), leaning)
    places = np.stack([0.2 * times**2, 0 * times, 1 + 0 * times], axis=1)
    drive = na.path_drive(emulator, {"chest": na.RecordedPath("bow", times, places, orientations)})
    assert not drive.remarks
    states = np.asarray(emulator.rollout(drive.start, drive.controls))
    told = states[:, emulator.state.index("chest_orientation")]
    sign = np.sign((told * orientations).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(sign * told, orientations, atol=1e-4)
    carried = states[0, emulator.state.index("arm")] - states[0, emulator.state.index("chest")]
    np.testing.assert_allclose(
        carried, rotate(orientations[0], np.array([0.0, 0.4, -0.3])), atol=0.01
    )


def test_a_character_moves_the_movers_called_as_its_bones(wrap, emulator, tmp_path):
    rng = np.random.default_rng(3)
    start = wrap.sample_starts(rng, 1)[0]
    controls = wrap.sample_paths(rng, 1, 40, DT, start[None])[0]
    states = np.asarray(emulator.rollout(start, controls), float)
    character = tmp_path / "character.glb"
    na.write_glb(na.make_clip(emulator, states, rate=30), character)
    found = paths_of_nodes(read_glb(character), character, movers_of(emulator))
    assert sorted(found) == ["arm", "chest"]
    drive = na.path_drive(emulator, found)
    followed = np.asarray(emulator.rollout(drive.start, drive.controls), float)[: len(states), :14]
    for first in (3, 10):
        sign = np.sign((followed * states[: len(followed), :14])[:, first : first + 4].sum(axis=1))
        followed[:, first : first + 4] *= sign[:, None]
    np.testing.assert_allclose(followed, states[: len(followed), :14], atol=2e-3)
    nameless = character_without_names(tmp_path)
    with pytest.raises(
        ArgumentError, match="no node of .* is called as a mover. Movers: arm, chest"
    ):
        paths_of_nodes(read_glb(nameless), nameless, movers_of(emulator))


def test_a_garment_follows_its_wearer_frame_by_frame(wrap, emulator, tmp_path):
    """It is drawn with him, in one file, and its capsules, which stand for him, are not."""
    rng = np.random.default_rng(3)
    start = wrap.sample_starts(rng, 1)[0]
    controls = wrap.sample_paths(rng, 1, 40, DT, start[None])[0]
    wearer = na.make_clip(emulator, np.asarray(emulator.rollout(start, controls), float), rate=30)
    worn = wear(wearer, emulator)
    assert worn.scores.shape == (40,)
    np.testing.assert_allclose(worn.clip.times, wearer.times)
    positions = worn.clip.states[:, :3] - wearer.states[:, :3]
    assert np.abs(positions).max() < 1e-3
    assert not any(bone.shapes for bone in worn.clip.skeleton.bones)
    na.write_glb([wearer, worn.clip], tmp_path / "dressed.glb")
    surfaces = [
        node for node in read_glb(tmp_path / "dressed.glb").objects("nodes") if "weights" in node
    ]
    assert len(surfaces) == 2


def character_without_names(folder: Path) -> Path:
    """Return a GLB file whose bones are called otherwise."""
    pendulum = na.load_emulator("pendulum-50")
    drive = na.make_clip(pendulum, np.zeros((5, pendulum.state.size)), rate=30)
    na.write_glb(drive, folder / "pendulum.glb")
    return folder / "pendulum.glb"


def test_only_what_turns_freely_has_a_turn_speed_of_each_axis(toml):
    faulty = toml.with_name("faulty.toml")
    faulty.write_text(TOML.replace('turns = "freely"', "turns = true", 1))
    with pytest.raises(NeuroAnimatorError, match='three numbers are for turns = "freely"'):
        na.load_system(str(faulty))
    faulty.write_text(TOML.replace('turns = "freely"', 'turns = "about"', 1))
    with pytest.raises(NeuroAnimatorError, match="turns"):
        na.load_system(str(faulty))


def test_a_bone_is_drawn_where_it_is(wrap):
    states = moving_states(wrap)[5:9]
    bones = {bone.name: number for number, bone in enumerate(wrap.skeleton.bones)}
    positions, orientations = wrap.skeleton.world_poses(states)
    np.testing.assert_allclose(positions[:, bones["arm"]], states[:, :3], atol=1e-9)
    np.testing.assert_allclose(orientations[:, bones["arm"]], states[:, 3:7], atol=1e-9)
