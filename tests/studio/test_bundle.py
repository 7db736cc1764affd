"""A bundle says all that the page needs, and the bundles that ship are those of the emulators that ship."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neuroanimator import load_emulator
from neuroanimator.appearance.skeleton import Skeleton
from neuroanimator.appearance.skin_mesh import colours_of, skin_mesh
from neuroanimator.control.objective.goals import is_reached
from neuroanimator.control.policies.state_policy import Perceptron, StatePolicy, View
from neuroanimator.errors import BadFileError
from neuroanimator.files.zoo import find_emulator, shipped_policy
from neuroanimator.learn.evaluation.held_out import system_of
from neuroanimator.state.pose import Pose, read_heights, read_pose
from neuroanimator.state.rotation import rotate
from neuroanimator.systems import trusted_files
from neuroanimator_studio.bundle import (
    bundle_facts,
    digest,
    load_models,
    make_bundle,
    policy_beside,
)
from neuroanimator_studio.catalogue import (
    EMULATOR,
    EXAMPLE_BUNDLES,
    PHYSICS_BUNDLES,
    SHIPPED_BUNDLES,
    catalogue,
    shipped_bundles,
    shipped_folder,
)
from neuroanimator_studio.description import describe_verdict, unpacked
from neuroanimator_studio.ship import example_facts

MAX_FILE = 1 << 20
"""No file of a bundle that ships is larger [bytes], but those of soft bodies."""

MAX_SOFT_FILE = 6 << 20
"""Maximum size of one of these [bytes]: their networks are ten times as large, and thousands of nodes are drawn."""

WITH_SKIN = ("dolphin-50", "fish-50")


def shipped(name: str) -> dict[str, Any]:
    return json.loads((shipped_folder() / name / "bundle.json").read_text())


@pytest.mark.parametrize("name", SHIPPED_BUNDLES)
def test_a_shipped_bundle_made_anew_says_the_same(name: str):
    source = find_emulator(name)
    emulator = load_emulator(name)
    facts = shipped(name)
    remade = bundle_facts(source, emulator, policy_beside(source, emulator), name)
    assert facts["sha256"] == hashlib.sha256(source.read_bytes()).hexdigest()
    # Through text, as the page reads it; what is computed may differ in its last digits on another machine.
    again = json.loads(json.dumps(remade))
    assert again.keys() == facts.keys()
    for key, value in facts.items():
        if key not in ("skin", "version"):
            assert same(again[key], value), key


def same(one: Any, other: Any) -> bool:
    """Whether two things out of JSON are equal, numbers but for rounding."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float | int):
        return abs(one - other) <= 1e-6 * max(1.0, abs(other))
    return one == other


def test_no_file_that_ships_is_large():
    for name in SHIPPED_BUNDLES:
        files = list((shipped_folder() / name).iterdir())
        assert {"bundle.json", "emulator.wasm"} <= {path.name for path in files}, name
        largest = MAX_SOFT_FILE if load_emulator(name).skeleton.shapes else MAX_FILE
        assert max(path.stat().st_size for path in files) <= largest, name


def test_a_bundle_says_how_good_its_emulator_is_where_it_was_trained():
    verdict = describe_verdict(load_emulator("fish-50"))
    assert verdict is not None
    assert shipped("fish-50")["verdict"] == verdict


@pytest.mark.parametrize("name", ["fish-50", "truck-50"])  # by its nodes, and by its joints
def test_bones_are_complete_and_pose_as_the_emulators_do(name: str):
    emulator = load_emulator(name)
    skeleton = Skeleton.from_json(shipped(name)["skeleton"], emulator.state.size)
    positions, orientations = skeleton.world_poses(emulator.rest[None])
    wanted_positions, wanted_orientations = emulator.skeleton.world_poses(emulator.rest[None])
    np.testing.assert_allclose(positions, wanted_positions, atol=1e-9)
    np.testing.assert_allclose(orientations, wanted_orientations, atol=1e-9)


@pytest.mark.parametrize("name", WITH_SKIN)
def test_a_skin_arrives_whole(name: str):
    skeleton = load_emulator(name).skeleton
    assert skeleton.skin is not None
    mesh = skin_mesh(skeleton)
    skin = shipped(name)["skin"]
    count = len(mesh.points)
    np.testing.assert_array_equal(
        unpacked(skin["positions"], "<f4").reshape(-1, 3), mesh.points.astype("f4")
    )
    np.testing.assert_allclose(
        unpacked(skin["colours"], "<f4").reshape(-1, 3),
        colours_of(skeleton.skin, mesh.shades),
        atol=1e-6,
    )
    weights = unpacked(skin["weights"], "<f4").reshape(count, 4)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    assert unpacked(skin["bones"], "<u2").max() < len(skeleton.bones)
    uvs = unpacked(skin["uvs"], "<f4").reshape(count, 2)
    assert uvs.min() >= 0
    assert uvs.max() <= 1
    triangles = unpacked(skin["indices"], "<u4").reshape(-1, 3)
    assert {tuple(row) for row in triangles} == {tuple(row) for row in mesh.triangles}
    ends = [0]
    for _, first, size in skin["parts"]:
        assert first == ends[-1]
        ends.append(first + size)
    assert ends[-1] == triangles.size


@pytest.mark.parametrize("name", ["fish-50", "lander-50"])
def test_where_a_body_is_and_points_follows_from_the_root(name: str):
    emulator = load_emulator(name)
    facts = shipped(name)
    motion = facts["default_motion"]
    state = np.asarray(emulator.rollout(motion["start"], motion["controls"][:4]), float)[-1]
    wanted = read_pose(emulator.state_structure, state)
    pose = pose_of(facts["root"], state)
    for said, known in zip(pose, wanted, strict=True):
        np.testing.assert_allclose(said, known, atol=1e-6)


def pose_of(root: dict[str, Any], state: np.ndarray) -> Pose:
    """As the page reads it."""
    if root["kind"] == "free":
        first = root["orientation"]
        orientation = state[first : first + 4]
        return Pose(
            state[root["position"] : root["position"] + 3],
            state[root["velocity"] : root["velocity"] + 3],
            rotate(orientation, np.array([1.0, 0, 0])),
            rotate(orientation, np.array([0, 0, 1.0])),
        )
    sums = {}
    for key in ("position", "velocity", "forward", "up"):
        sums[key] = sum(weight * state[entry : entry + 3] for entry, weight in root[key])
    forward = sums["forward"] / np.linalg.norm(sums["forward"])
    up = sums["up"] / np.linalg.norm(sums["up"])
    return Pose(sums["position"], sums["velocity"], forward, up)


@pytest.mark.parametrize("name", ["lander-50", "pendulum-50", "truck-50"])
def test_what_is_shown_first_reaches_a_goal(name: str):
    emulator = load_emulator(name)
    system = system_of(emulator)
    motion = shipped(name)["default_motion"]
    states = np.asarray(emulator.rollout(motion["start"], motion["controls"]), float)
    assert any(is_reached(system, goal, states[-1]) for goal in system.goals)
    assert not any(is_reached(system, goal, states[0]) for goal in system.goals)


@pytest.mark.parametrize("name", WITH_SKIN)
def test_what_is_shown_first_of_a_swimmer_goes_far_and_has_commands(name: str):
    emulator = load_emulator(name)
    facts = shipped(name)
    motion = facts["default_motion"]
    states = np.asarray(emulator.rollout(motion["start"], motion["controls"]), float)
    pose = read_pose(emulator.state_structure, states)
    assert np.linalg.norm(pose.position[-1] - pose.position[0]) > facts["size"]
    assert [row[0] for row in facts["policy"]["command"]] == ["speed", "turn", "climb", "roll"]


def test_the_dolphin_is_shown_leaping_and_so_it_does_on_the_true_springs():
    emulator = load_emulator("dolphin-50")
    system = system_of(emulator)
    motion = shipped("dolphin-50")["default_motion"]
    controls = np.array(motion["controls"])
    emulated = np.asarray(emulator.rollout(motion["start"], controls), float)
    true = system.simulate_fastest(np.array([motion["start"]]), controls[None], emulator.dt).states[
        0
    ]
    for states in (emulated, true):
        heights = read_heights(system.structure, states)
        assert heights.min(axis=1).max() > 0.5  # all of it is out of the water
        assert heights[0].max() < -1
        assert heights[-1].max() < 0  # and in again


def test_a_shipped_program_makes_the_steps_of_its_emulator():
    wasmtime = pytest.importorskip("wasmtime")
    from neuroanimator.export.programs.wasm_file import WasmModule

    emulator = load_emulator("pendulum-50")
    content = (shipped_folder() / "pendulum-50" / "emulator.wasm").read_bytes()
    state = np.array([0.1, -0.2, 0.3, 0.5, 0.0, -0.5], np.float32)
    control = np.array([1.0, -1.0, 0.5], np.float32)
    following = np.zeros(6, np.float32)
    WasmModule(wasmtime, content, "emulator").call("step", state, control, following)
    np.testing.assert_allclose(following, emulator.step(state, control), atol=1e-4)


def test_a_policys_bundle_takes_the_programs_of_the_emulator_it_was_trained_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def refuse(*_: object) -> None:
        raise AssertionError("compiled what was there")

    monkeypatch.setattr("neuroanimator_studio.bundle._compile", refuse)
    folder = make_bundle(str(shipped_policy("fish")), tmp_path / "own", known=shipped_bundles())
    fish = shipped_folder() / "fish-50"
    for name in ("emulator.wasm", "descent-1.wasm"):
        assert (folder / name).read_bytes() == (fish / name).read_bytes()
    assert (folder / "policy.wasm").read_bytes()[:4] == b"\0asm"
    made = json.loads((folder / "bundle.json").read_text())
    assert made["digest"] == shipped("fish-50")["digest"]
    assert made["descents"] == json.loads(json.dumps(shipped("fish-50")["descents"]))
    assert made["policy"] is not None


MAX_EXAMPLE_FILE = 5 << 19
"""Maximum size of a file of an example's bundle [bytes]: an emulator's weights are in it more than once."""


def test_the_human_that_ships_is_the_one_of_the_examples_and_takes_commands(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(trusted_files, "_MODELS", [])  # other tests may have found his model
    folder = shipped_folder() / "human"
    file = Path(__file__).parents[2] / EXAMPLE_BUNDLES["human"].file
    assert (folder / EMULATOR).read_bytes() == file.read_bytes()
    assert max(path.stat().st_size for path in folder.iterdir()) <= MAX_EXAMPLE_FILE
    facts = shipped("human")
    remade = json.loads(json.dumps(example_facts("human", folder)))
    assert remade.keys() == facts.keys()
    assert all(same(remade[key], value) for key, value in facts.items() if key != "version")
    names = [row[:2] for row in facts["policy"]["command"]]
    assert names == [["speed", "m/s"], ["turning", "rad/s"]]
    assert not facts["can_simulate"]


def test_a_state_policy_that_takes_no_commands_is_refused(tmp_path: Path):
    emulator = load_emulator("pendulum")
    view = View(jnp.zeros(2), jnp.ones(2), (0, 1))
    network = Perceptron.fresh((2, 4, emulator.control.size), jax.random.key(0), 1.0)
    file = tmp_path / "swing.policy.safetensors"
    StatePolicy(emulator, view, network).save(file)
    with pytest.raises(BadFileError, match="takes no commands"):
        load_models(file)


def test_an_emulator_with_one_other_weight_has_another_digest():
    emulator = load_emulator("pendulum-50")
    assert digest(emulator) == shipped("pendulum-50")["digest"]
    moved = eqx.tree_at(lambda one: one.domain.low, emulator, emulator.domain.low - 1e-3)
    assert digest(moved) != digest(emulator)


def test_the_catalogue_names_every_shipped_bundle_once(tmp_path: Path):
    described = catalogue(shipped_bundles(), has_server=False)
    shipped = [*SHIPPED_BUNDLES, *PHYSICS_BUNDLES, *EXAMPLE_BUNDLES]
    assert [row["id"] for row in described["entries"]] == shipped
    assert all(row["bundle"] == f"bundles/{row['id']}/" for row in described["entries"])
    assert not described["has_server"]
