"""A cloth on a character: movers are proposed from his bones, and follow his animation in random runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from characters import ENDS, JOINTS, RADII, arm_turned, surface_points, trunk_at, write_character
from scipy.spatial.transform import Rotation
from soft_bodies import hanging_cloth

import neuroanimator as na
from neuroanimator.animation.glb_rig import Rig
from neuroanimator.animation.recorded_path import paths_of_nodes
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.files.glb import read_glb
from neuroanimator.physics.loading import from_text, resolve
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems import movers as movers_module
from neuroanimator.systems.named_files import read_definition

DT = 1 / 30


def proposed(folder: Path, forge=lambda document: None, left_at: float = 0.0) -> Path:
    hanging_cloth(folder, "scarf", "")
    who = write_character(folder / "who.glb", left_at, forge)
    path, _ = write_definition(str(folder / "scarf.obj"), character=who, force=True)
    return path


@pytest.fixture(scope="module")
def scarf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the TOML file of a scarf of few shapes and long steps, with its character beside it."""
    path = proposed(tmp_path_factory.mktemp("scarf"))
    text = path.read_text().replace("substeps = 40", "substeps = 20")
    for steps in (1200, 2400, 12000):
        text = text.replace(f"step = {1 / steps}\n", f"step = {2 / steps}\n")
    path.write_text(text.replace("shapes = 96", "shapes = 24"))
    return path


def quaternion(turn: Rotation) -> np.ndarray:
    return np.roll(turn.as_quat(), 1)


@pytest.mark.parametrize("left_at", [0.0, 2.0])
def test_a_bone_turns_from_the_pose_its_skin_is_bound_to(tmp_path: Path, left_at: float):
    """Wherever an exporter has left the nodes, and however the bone's own axes lie."""
    path = write_character(tmp_path / "who.glb", left_at)
    paths = paths_of_nodes(read_glb(path), path, ("trunk", "arm.L", "arm.R"))
    _, heading = trunk_at(left_at)
    for time in (0.0, 1.3, 4.0):
        place, turn = trunk_at(time)
        for name in JOINTS:
            positions, orientations = paths[name].at(np.array([time]))
            assert orientations is not None
            arm = arm_turned(name, time) if name != "trunk" else Rotation.identity()
            # The topmost joint lies as its node was left.
            expected = quaternion(turn * arm * heading.inv())
            assert abs(orientations[0] @ expected) > 1 - 1e-5 or left_at
            offset = turn.apply(np.subtract(JOINTS[name], JOINTS["trunk"]))
            np.testing.assert_allclose(positions[0], place + offset, atol=2e-4)
    # Against the trunk an arm turns as it does, whatever the rest.
    _, trunk = paths["trunk"].at(np.array([1.3]))
    _, arm = paths["arm.L"].at(np.array([1.3]))
    back = Rotation.from_quat(np.roll(trunk[0], -1)).inv()
    relative = back * Rotation.from_quat(np.roll(arm[0], -1))
    turned = heading * arm_turned("arm.L", 1.3) * heading.inv()
    assert (relative * turned.inv()).magnitude() < 2e-3


def test_bones_carry_the_points_that_they_move_most(tmp_path: Path):
    bones = Rig(read_glb(write_character(tmp_path / "who.glb"))).bones()
    assert [bone.name for bone in bones] == ["rig:trunk", "rig:arm.L", "rig:arm.R"]
    assert [bone.above for bone in bones] == ["", "rig:trunk", "rig:trunk"]
    for bone in bones:
        name = bone.name.removeprefix("rig:")
        np.testing.assert_allclose(bone.points, surface_points(name), atol=1e-6)
        np.testing.assert_allclose(bone.position, JOINTS[name], atol=1e-6)


def test_capsules_are_as_thick_and_long_as_the_limbs(tmp_path: Path):
    _, definition = read_definition(proposed(tmp_path))
    assert set(definition.movers) == set(JOINTS)
    assert definition.motions == "who.glb"
    for name, mover in definition.movers.items():
        (capsule,) = mover.colliders
        assert capsule.radius == pytest.approx(RADII[name], rel=0.15)
        ends = np.array([capsule.start, capsule.end]) + mover.position
        along = np.subtract(ENDS[name], JOINTS[name])
        inside = np.linalg.norm(along) - 2 * RADII[name]
        assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(inside, abs=0.04)
        middle = np.add(ENDS[name], JOINTS[name]) / 2
        np.testing.assert_allclose(ends.mean(axis=0), middle, atol=0.02)
    assert [name for name, mover in definition.movers.items() if mover.pins] == ["trunk"]


def test_random_runs_follow_the_animation(scarf: Path, monkeypatch):
    """Arms against the trunk are as in the file, after the way there from rest; and no mover is faster than it may be."""
    system = na.load_system(str(scarf))
    assert isinstance(system, SoftSystem)
    monkeypatch.setattr(movers_module, "FOLLOWING", 1.0)
    monkeypatch.setattr(movers_module, "STRAYING", 0.0)
    monkeypatch.setattr(movers_module, "PLAYED", (1.0, 1.0))
    movers = system.scene.movers
    starts = np.repeat(system.rest[None], 3, axis=0)
    controls = system.sample_paths(np.random.default_rng(0), 3, 120, DT, starts)
    assert system.bounds.contain(controls)
    poses = movers.paths(starts[:, : movers.size], controls, DT)[:, 90:]
    trunk, arm = (movers.places[movers.names.index(name)] for name in ("trunk", "arm.L"))
    assert movers.motions is not None
    recorded = movers.motions.poses
    for run in poses:
        tilt = relative(run[:, trunk.entries], run[:, arm.entries])
        known = relative(recorded[:, trunk.entries], recorded[:, arm.entries])
        nearest = np.abs(tilt[:, None] - known[None]).max(axis=2).min(axis=1)
        assert nearest.max() < 0.06
        speed = np.linalg.norm(np.diff(run[:, trunk.entries][:, :3], axis=0), axis=1) / DT
        assert speed.mean() == pytest.approx(0.5, rel=0.1)


def relative(trunk: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return where an arm is, and how it is turned, seen from the trunk."""
    back = Rotation.from_quat(np.roll(trunk[:, 3:], -1, axis=1)).inv()
    turned = back * Rotation.from_quat(np.roll(arm[:, 3:], -1, axis=1))
    return np.concatenate([back.apply(arm[:, :3] - trunk[:, :3]), turned.as_rotvec()], axis=1)


def test_motions_travel_with_the_shapes(scarf: Path):
    """What an emulator or a dataset names is enough for more data of the same kind; the character need not be there."""
    first = na.load_system(str(scarf))
    _, text, _ = resolve(str(scarf))
    character = scarf.with_name("who.glb")
    hidden = character.rename(scarf.with_name("hidden.glb"))
    second = from_text(text)
    hidden.rename(character)
    assert isinstance(first, SoftSystem)
    assert isinstance(second, SoftSystem)
    runs = [system.sample_paths(np.random.default_rng(1), 2, 20, DT) for system in (first, second)]
    np.testing.assert_array_equal(*runs)


def test_without_an_animation_bones_wander(tmp_path: Path):
    _, definition = read_definition(proposed(tmp_path, lambda document: document.pop("animations")))
    assert definition.motions is None
    assert {mover.speed for mover in definition.movers.values()} == {(2.0, 2.0, 2.0)}


REFUSED = {
    "no skin": (lambda document: document.pop("skins"), "no bones that move a skin"),
    "few matrices": (lambda d: d["accessors"][d["skins"][0]["inverseBindMatrices"]].update(count=2), "3 joints with 2"),
    "no such joint": (lambda d: d["skins"][0].update(joints=[0, 1]), "2 joints with 3 matrices"),
    "no such skin": (lambda d: d["nodes"][3].update(skin=4), "number of a skin: wanted"),
    "no points": (lambda d: d["meshes"][0]["primitives"][0].pop("attributes"), "a mesh without attributes"),
    "twins": (lambda d: d["nodes"][1].update(name="rig:arm.R"), "2 nodes are called"),
}  # fmt: skip
"""By name, a change of the character's document, and what is said of it."""


@pytest.mark.attack
@pytest.mark.parametrize("name", REFUSED)
def test_a_forged_skin_is_refused(tmp_path: Path, name: str):
    forge, message = REFUSED[name]
    with pytest.raises(NeuroAnimatorError, match=message) as caught:
        proposed(tmp_path, forge)
    assert "\n" not in str(caught.value)


def test_a_motion_faster_than_its_mover_is_refused(tmp_path: Path):
    """As that of a character in centimetres is, or one that jumps."""
    path = proposed(tmp_path)
    _, definition = read_definition(path)
    fast = definition.movers["trunk"].speed[0]
    path.write_text(path.read_text().replace(f"{[fast] * 3}", "[0.3, 0.3, 0.3]"))
    with pytest.raises(
        NeuroAnimatorError, match=r"moves at up to 0\.5\d* m/s .* speed is 0\.3\. Raise it"
    ):
        na.load_system(str(path))


def test_a_character_is_for_a_cloth_beside_it(tmp_path: Path):
    who = write_character(tmp_path / "who.glb")
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    hanging_cloth(folder, "scarf", "").unlink()
    with pytest.raises(NeuroAnimatorError, match=r"must be beside who\.glb"):
        write_definition(str(folder / "scarf.obj"), character=who)
    (tmp_path / "my.csv").write_text("time,x\n0,0\n")
    with pytest.raises(NeuroAnimatorError, match="--character are for meshes"):
        write_definition(str(tmp_path / "my.csv"), character=who)
