"""What the page is told of a soft body: its surface arrives whole, and its movers wander as they may."""

from __future__ import annotations

import numpy as np
import pytest
from cloths import untrained_cloth

from neuroanimator import Emulator
from neuroanimator.appearance.shapes import COARSE_MODES, Shapes
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.state.placement import Placement
from neuroanimator_studio.description import describe_emulator, unpacked
from neuroanimator_studio.opening import opening_drive


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Emulator:
    return untrained_cloth(tmp_path_factory.mktemp("cloth"))


def test_a_surface_arrives_whole(emulator: Emulator):
    shapes = emulator.skeleton.shapes
    assert shapes is not None
    facts = describe_emulator(emulator, system_of(emulator))
    said = facts["surface"]
    nodes = len(shapes.mean)
    modes = unpacked(said["modes"], "<i2").reshape(-1, nodes, 3)
    tensors = {
        "mean": unpacked(said["mean"], "<f4").reshape(nodes, 3),
        "modes": modes[:COARSE_MODES],
        "fine_modes": modes[COARSE_MODES:].astype(np.int8),
        "scales": unpacked(said["scales"], "<f4"),
        "faces": unpacked(said["faces"], "<u4").reshape(-1, 3).astype(np.int32),
    }
    placement = Placement(**said["placement"])
    again = Shapes.from_tensors(tensors, said["first"], placement, emulator.state.size)
    states = np.asarray(emulator.rollout(emulator.rest, np.zeros((3, emulator.control.size))))
    np.testing.assert_allclose(again.decode(states), shapes.decode(states), atol=1e-5)
    assert facts["size"] == pytest.approx(np.ptp(shapes.mean, axis=0).max())
    assert facts["scene"] == {"kind": "plain", "surface": None, "floor": None}


def test_movers_are_where_their_state_and_control_entries_say(emulator: Emulator):
    facts = describe_emulator(emulator, system_of(emulator))
    assert [row[0] for row in facts["movers"]] == ["ball", "holder"]
    for number, (name, entry, control, size) in enumerate(facts["movers"]):
        held = np.zeros((1, emulator.control.size), np.float32)
        held[0, control : control + size] = [0.1, -0.2, 0.3, 0.4][:size]
        states = np.asarray(emulator.rollout(emulator.rest, held), float)
        moved = states[1] - states[0]
        wanted = emulator.dt * held[0, control : control + size]
        np.testing.assert_allclose(moved[entry : entry + size], wanted, atol=1e-6)
        bone = emulator.skeleton.bones[number]
        assert bone.name == name
        assert [joint.entry for joint in bone.joints] == list(range(entry, entry + size))


def test_movers_wander_within_their_bounds_strike_and_end_where_they_began(emulator: Emulator):
    drive = opening_drive(emulator, system_of(emulator))
    bounds = emulator.bounds
    assert (drive.controls > np.array(bounds.low)).all()
    assert (drive.controls < np.array(bounds.high)).all()
    moved = emulator.dt * np.cumsum(drive.controls, axis=0)
    np.testing.assert_allclose(moved[-1], 0, atol=1e-9)
    shapes = emulator.skeleton.shapes
    assert shapes is not None
    start = np.array(emulator.rest)
    balls = start[:3] + moved[:, :3]
    middle = shapes.decode(start).mean(axis=0)
    assert np.linalg.norm(balls - middle, axis=1).min() < 0.4 * np.linalg.norm(start[:3] - middle)
    assert np.abs(moved[:, 3:]).max(axis=0).min() > 0.02
