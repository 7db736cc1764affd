"""Laws of a solid that nothing holds, and the Gmsh files it comes from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from jelly_mesh import cube, msh_2, msh_4
from soft_bodies import hasty_emulator, moving_states, poses_of

import neuroanimator as na
from neuroanimator.control.policies import train_policy
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.export.morphs import surface_normals
from neuroanimator.physics.loading import resolve
from neuroanimator.physics.soft.find_shapes import RestingShapes
from neuroanimator.physics.soft.mesh_file import read_mesh
from neuroanimator.physics.soft.own_frame import seen_from_root
from neuroanimator.physics.soft.program import SoftProgram
from neuroanimator.physics.soft.scene import Scene
from neuroanimator.physics.soft.soft_system import SoftSystem
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.state.rotation import continuous, facing, multiply, rotate, rotation_between

DT = 1 / 30


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("jelly")
    (folder / "jelly.msh").write_text(msh_4(*cube()))
    path, _ = write_definition(str(folder / "jelly.msh"))
    text = path.read_text().replace("shapes = 96", "shapes = 24\ncontact_nodes = 16")
    text = text.replace("step = 0.0008333333333333334", "step = 0.0016666666666666668")
    text = text.replace("substeps = 40", "substeps = 20")
    path.write_text(text + "[air]\ndrag = 0.0\ndensity = 0.0\n")
    return path


@pytest.fixture(scope="module")
def jelly(toml: Path):
    return na.load_system(str(toml))


def flying(jelly, count: int = 4) -> np.ndarray:
    """Return states of the body 5 m above the ground, moving and spinning, far from the paddle."""
    states = moving_states(jelly)[20 : 20 + count].copy()
    rng = np.random.default_rng(4)
    states[:, jelly.state.index("position")] = [3.0, 0.0, 5.0]
    states[:, jelly.state.index("velocity")] = rng.normal(size=(count, 3))
    states[:, jelly.state.index("angular_velocity")] = rng.normal(size=(count, 3))
    return states


def taken_apart(jelly, states: np.ndarray) -> np.ndarray:
    """Return the states of the nodes of `states`."""
    motion = jelly.motion(states)
    positions, velocities = (np.moveaxis(part, -1, 0) for part in motion[:2])
    size = jelly.control.size
    movers, rates = states[:, :size], states[:, size : 2 * size]
    return jelly.encode(positions, velocities, movers, rates, motion.origin.T)


def elsewhere(jelly, states: np.ndarray, shift: np.ndarray, angle: float) -> np.ndarray:
    """Return the same states in a world that is moved, and turned about Z."""
    moved = np.array(states, float)
    turned = np.broadcast_to(facing(np.array(angle)), (*moved.shape[:-1], 4))
    for part in jelly.state.slices:
        entries = jelly.state.index(part.name)
        if part.name == "orientation":
            moved[..., entries] = multiply(turned, moved[..., entries])
        elif part.name == "paddle_heading":
            moved[..., entries] += angle
        elif part.size == 3 and part.name != "angular_velocity":
            moved[..., entries] = rotate(turned, moved[..., entries])
            if part.unit == "m":
                moved[..., entries] += shift
    return moved


def turned_controls(controls: np.ndarray, angle: float) -> np.ndarray:
    turned = np.array(controls, float)
    about = np.broadcast_to(facing(np.array(angle)), (*controls.shape[:-1], 4))
    turned[..., :3] = rotate(about, turned[..., :3])
    return turned


SHIFT = np.array([40.0, -25.0, 0.0])
ANGLE = 2.0


def test_both_versions_of_a_file_hold_the_same_mesh():
    positions, tetrahedra = cube()
    for write in (msh_2, msh_4):
        mesh = read_mesh("jelly.msh", write(positions, tetrahedra).encode())
        np.testing.assert_array_equal(mesh.positions, positions)
        np.testing.assert_array_equal(mesh.elements, tetrahedra)


def test_nodes_of_no_tetrahedron_are_left_out():
    positions, tetrahedra = cube()
    more = np.concatenate([[[5.0, 5.0, 5.0]], positions])
    mesh = read_mesh("jelly.msh", msh_2(more, tetrahedra + 1).encode())
    np.testing.assert_array_equal(mesh.positions, positions)
    np.testing.assert_array_equal(mesh.elements, tetrahedra)


def test_the_state_has_a_root(jelly):
    names = [part.name for part in jelly.state.slices][4:]
    root = ["position", "orientation", "velocity", "angular_velocity"]
    assert names == [*root, "shapes", "shape_rates"]


def test_a_state_put_together_and_taken_apart_is_the_same(jelly):
    states = moving_states(jelly)[::40]
    again = taken_apart(jelly, states)
    root = jelly.state.index("orientation")
    states[:, root] *= np.sign((states[:, root] * again[:, root]).sum(axis=1))[:, None]
    np.testing.assert_allclose(again, states, atol=1e-6)
    decoded = np.moveaxis(jelly.motion(states).positions, -1, 0)
    decoded = decoded + states[:, None, jelly.state.index("position")]
    np.testing.assert_allclose(decoded, jelly.shapes.decode(states), atol=1e-9)


def test_a_rigid_motion_is_all_in_the_root(jelly):
    rng = np.random.default_rng(0)
    mean = jelly.shapes.mean
    orientation = rng.normal(size=4)
    orientation /= np.linalg.norm(orientation)
    velocity, spin = rng.normal(size=(2, 3))
    turned = np.broadcast_to(orientation, (len(mean), 4))
    nodes = np.array([1.0, 2.0, 3.0]) + rotate(turned, mean)
    velocities = velocity + rotate(turned, np.cross(spin, mean))
    own = seen_from_root(nodes, velocities, mean, jelly.scene.body.masses)
    orientation *= np.sign(orientation @ own.root[3:7])
    expected = np.concatenate([[1.0, 2.0, 3.0], orientation, velocity, spin])
    np.testing.assert_allclose(own.root, expected, atol=1e-9)
    np.testing.assert_allclose(own.positions, mean, atol=1e-9)
    np.testing.assert_allclose(own.velocities, 0, atol=1e-9)


def test_rates_are_derivatives_and_the_root_moves_as_it_says(jelly):
    states = flying(jelly)
    size = jelly.control.size
    states[:, size : 2 * size] = 0
    motion = jelly.motion(states)
    velocities = np.moveaxis(motion.velocities, -1, 0)
    positions = np.moveaxis(motion.positions + motion.origin, -1, 0)
    step = 1e-6
    still = np.zeros((len(states), size))
    now = jelly.encode(positions, velocities, still, still)
    later = jelly.encode(positions + step * velocities, velocities, still, still)
    count = len(jelly.shapes.modes)
    slopes = (later - now)[:, jelly.shapes.amplitudes] / step
    np.testing.assert_allclose(slopes, states[:, -count:], atol=2e-3)
    entries = jelly.state.index("orientation")
    turned = rotation_between(now[:, entries], later[:, entries]) / step
    np.testing.assert_allclose(turned, now[:, jelly.state.index("angular_velocity")], atol=2e-3)


def test_momentum_is_conserved_in_free_fall(jelly):
    starts = flying(jelly)
    steps = 12
    states = jelly.simulate(starts, np.zeros((len(starts), steps, 4)), DT).states
    velocity = states[..., jelly.state.index("velocity")]
    fallen = np.outer(np.arange(steps + 1) * DT, [0, 0, -9.81])
    np.testing.assert_allclose(velocity, velocity[:, :1] + fallen, atol=5e-3)
    momenta = np.stack([_spin(jelly, states[:, step]) for step in range(steps + 1)], axis=1)
    size = np.linalg.norm(momenta[:, :1], axis=-1, keepdims=True)
    assert (np.abs(momenta - momenta[:, :1]) < 0.05 * size).all()


def _spin(jelly, states: np.ndarray) -> np.ndarray:
    """Return the angular momenta [kg·m²/s] about the centre."""
    motion = jelly.motion(states)
    about = np.cross(motion.positions, motion.velocities, axis=1)
    return np.einsum("n,nkl->lk", jelly.scene.body.masses, about)


def test_rest_stays_rest(jelly):
    states = jelly.simulate(jelly.rest[None], np.zeros((1, 30, 4)), DT).states[0]
    np.testing.assert_allclose(states[-1], states[0], atol=5e-3)


def test_moving_and_turning_the_world_does_not_change_the_physics(jelly):
    starts = moving_states(jelly)[60:64]
    controls = jelly.sample_paths(np.random.default_rng(0), 4, 6, DT, starts)
    here = jelly.simulate(starts, controls, DT).states
    moved = elsewhere(jelly, starts, SHIFT, ANGLE)
    there = jelly.simulate(moved, turned_controls(controls, ANGLE), DT).states
    expected = elsewhere(jelly, here, SHIFT, ANGLE)
    np.testing.assert_allclose(there, expected, atol=2e-2)
    nodes = jelly.shapes.decode(there) - jelly.shapes.decode(expected)
    assert np.sqrt((nodes**2).mean()) < 1e-4


def test_moving_and_turning_the_world_does_not_change_what_is_shown(jelly):
    contacts = jelly.structure.shape_contacts
    states = moving_states(jelly)[::20]
    controls = jelly.sample_paths(np.random.default_rng(1), len(states), 1, DT, states)[:, 0]
    here = np.concatenate(contacts.shown(states, controls, DT), axis=-1)
    assert here.shape[-1] == contacts.size
    moved = elsewhere(jelly, states, SHIFT, ANGLE)
    there = contacts.shown(moved, turned_controls(controls, ANGLE), DT)
    np.testing.assert_allclose(np.concatenate(there, axis=-1), here, atol=1e-6)
    assert here[:, -4 * len(contacts.nodes) :].any(axis=1).mean() > 0.3


def test_starts_are_at_rest_thrown_and_struck_and_none_has_diverged(jelly):
    starts = jelly.sample_starts(np.random.default_rng(0), 400)
    assert not jelly.has_diverged(starts[:, None]).any()
    height = starts[:, jelly.state.index("position")][:, 2]
    spin = np.abs(starts[:, jelly.state.index("angular_velocity")]).max(axis=1)
    assert (height > jelly.rest[10] + 0.5 * jelly.scene.size).mean() > 0.02
    assert (spin > 2).mean() > 0.05
    assert (starts == jelly.rest).all(axis=1).mean() > 0.1
    lost = starts[:1, None].copy()
    lost[..., -1] = np.nan
    assert jelly.has_diverged(lost).all()


def test_a_motion_that_is_no_number_is_told_as_such(jelly):
    nodes = np.stack([jelly.shapes.mean, jelly.shapes.mean])
    nodes[0, 3] = np.nan
    own = seen_from_root(nodes, np.zeros_like(nodes), jelly.shapes.mean, jelly.scene.body.masses)
    assert np.isnan(own.positions[0]).any()
    assert np.isfinite(own.positions[1]).all()


def test_the_paddle_strikes_it(jelly):
    controls = np.zeros((1, 12, 4))
    controls[0, :8, 0] = 0.8
    states = jelly.simulate(jelly.rest[None], controls, DT).states[0]
    moved = states[-1, jelly.state.index("position")] - jelly.rest[jelly.state.index("position")]
    assert moved[0] > 0.03


def test_signs_of_quaternions_are_steady():
    turned = np.array([[1.0, 0, 0, 0], [-1.0, 0, 0, 0], [-0.9, 0, 0, 0.4], [0.8, 0, 0, -0.6]])
    steady = continuous(turned, np.array([[-1.0, 0, 0, 0]]))
    assert (steady[:, 0] < 0).all()


def test_nothing_is_inside_a_box_that_turns(toml: Path, jelly):
    """Pushed by a turning paddle, nodes stay out of it, in its own axes."""
    body = jelly.scene.body
    frames = 20
    poses = np.zeros((frames + 1, 2, 4))
    poses[:, 0, 0] = np.linspace(-0.16, 0.05, frames + 1)
    poses[:, 0, 2] = 0.08
    poses[:, 0, 3] = np.linspace(0.0, 0.6, frames + 1)
    still = np.zeros_like(body.positions)
    program = SoftProgram(body, dtype=np.float64)
    path, _ = program.play(body.positions, still, poses_of(poses), DT, 40)
    assert path[-1][:, 0].mean() > 0.05
    for nodes, pose in zip(path, poses[1:, 0], strict=True):
        away = nodes - pose[:3]
        about = np.broadcast_to(facing(np.array(-pose[3])), (len(away), 4))
        within = np.array(body.boxes[0].half) - np.abs(rotate(about, away))
        assert within.min(axis=1).max() < 1e-9


@pytest.fixture(scope="module")
def emulator(toml: Path, tmp_path_factory: pytest.TempPathFactory) -> na.Emulator:
    return hasty_emulator(toml, tmp_path_factory.mktemp("trained"))


def test_the_prediction_of_a_turned_world_is_the_turned_prediction(jelly, emulator):
    starts = moving_states(jelly)[60:63].astype(np.float32)
    controls = jelly.sample_paths(np.random.default_rng(2), 3, 5, emulator.dt, starts)
    here = np.asarray(emulator.rollout(starts, controls.astype(np.float32)))
    moved = elsewhere(jelly, starts, SHIFT / 20, ANGLE).astype(np.float32)
    turned = turned_controls(controls, ANGLE).astype(np.float32)
    there = np.asarray(emulator.rollout(moved, turned))
    np.testing.assert_allclose(there, elsewhere(jelly, here, SHIFT / 20, ANGLE), atol=5e-3)


def test_the_paddle_follows_a_path_and_what_is_drawn_is_outside_of_it_and_above_the_ground(
    jelly, emulator
):
    times = np.linspace(0, 1, 31)
    rest = jelly.rest[:3]
    aim = jelly.shapes.decode(jelly.rest).mean(axis=0)
    places = rest + times[:, None] * (aim - rest)
    path = na.RecordedPath("swing", times, places, facing(0 * times))
    drive = na.path_drive(emulator, {"paddle": path}, speed=0.5)
    motion = drive.motion(emulator)
    paddle = motion[:, jelly.state.index("paddle")]
    np.testing.assert_allclose(paddle[-1], places[-1], atol=1e-4)
    clip = na.make_clip(emulator, motion)
    drawn = na.push_out(clip, emulator)
    contacts = emulator.frame.shape_contacts
    shapes = drawn.skeleton.shapes
    assert contacts is not None
    assert shapes is not None
    nodes = shapes.unplaced(drawn.states)
    before = clip.skeleton.shapes.unplaced(clip.states)
    pushed = [
        np.linalg.norm(contacts.pushed_out(part, clip.states) - part, axis=-1).max()
        for part in (before, nodes)
    ]
    assert pushed[0] > 0.01
    assert pushed[1] <= 1e-3
    assert shapes.decode(drawn.states)[..., 2].min() >= contacts.ground - 1e-3


def test_a_policy_of_a_jelly_is_refused(jelly, emulator, tmp_path: Path):
    with pytest.raises(NeuroAnimatorError, match="jelly is a soft body"):
        train_policy(emulator, jelly, tmp_path / "jelly.policy.safetensors")


def test_the_emulator_in_c_is_that_in_jax(jelly, emulator):
    start = moving_states(jelly)[60].astype(np.float32)
    controls = jelly.sample_paths(np.random.default_rng(2), 1, 5, emulator.dt, start[None])[0]
    controls = controls.astype(np.float32)
    in_c = np.asarray(emulator.rollout(start, controls))
    state = start
    for control in controls:
        state = np.asarray(emulator.step(state, control))
    np.testing.assert_allclose(in_c[-1], state, atol=1e-3)


def test_a_cost_of_a_node_follows_the_root(jelly):
    term = na.reach_node(jelly, 5, [0.1, 0.2, 0.3], within=0.5)
    seen = term.observe(moving_states(jelly)[60:64])
    wanted = jelly.shapes.decode(moving_states(jelly)[60:64], [5])[:, 0]
    np.testing.assert_allclose(seen, wanted, atol=1e-5)


REPLACED = {
    "not finite": ("0.2", "nan"),
    "no tetrahedra": (" 4 2 0 1 ", " 99 2 0 1 "),
    "second order": (" 4 2 0 1 ", " 11 2 0 1 "),
    "many": ("$Nodes\n8\n", "$Nodes\n1000000\n"),
    "binary": ("2.2 0 8", "2.2 1 8"),
    "other version": ("2.2 0 8", "4.0 0 8"),
    "short": ("$Elements\n", "$Elements\n9"),
    "a node twice": ("\n2 ", "\n1 "),
    "no msh": ("$MeshFormat", "v 0 0 0"),
    "more labels than numbers": (" 4 2 0 1 ", " 4 99 0 1 "),
    "a node that is not there": (" 8\n", " 9\n"),
}
"""By name, what of a file is replaced by what."""


def spoilt(change: str) -> str:
    """Return a file of version 2.2 with something wrong."""
    positions, tetrahedra = cube(1)
    if change == "inside out":
        tetrahedra[:3] = tetrahedra[:3, [1, 0, 2, 3]]
    if change == "doubled":
        positions[1] = positions[0]
    if change == "flat":
        positions[:, 2] *= 1e-9
    old, new = REPLACED.get(change, ("", ""))
    return msh_2(positions, tetrahedra).replace(old, new)


@pytest.mark.attack
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("inside out", "inside out, unlike others: tetrahedra of lines 18, 19, 20. Swap"),
        ("doubled", "at the place of others: nodes 2 of the file. Merge"),
        ("flat", "without volume: tetrahedra of line"),
        ("not finite", "wanted three coordinates"),
        ("no tetrahedra", "no tetrahedra. Mesh the inside"),
        ("second order", "second order"),
        ("many", "1,000,000 nodes, for which 60 GB would be needed"),
        ("binary", "wanted Gmsh MSH 2.2 or 4.1 in ASCII"),
        ("other version", "wanted Gmsh MSH 2.2 or 4.1 in ASCII"),
        ("short", "wanted at least 3 whole numbers"),
        ("more labels than numbers", "wanted four nodes of the file"),
        ("a node that is not there", "wanted four nodes of the file"),
        ("a node twice", "two nodes have the same number"),
        ("no msh", "no \\$MeshFormat"),
    ],
)
def test_a_mesh_that_is_none_is_refused_by_name(tmp_path: Path, change: str, message: str):
    (tmp_path / "a.msh").write_text(spoilt(change))
    with pytest.raises(NeuroAnimatorError, match=message) as caught:
        write_definition(str(tmp_path / "a.msh"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("position = [-0.16", "position = [-0.05", "begin inside a collider of 'paddle'"),
        ("height = 0.0", "height = 0.1", "begin under it. Lower it"),
        ("turns = true", "pins = [99]", "pins: 99 are not nodes; the mesh has 0 to 63"),
        ("box = [0.02", "radius = 0.1\nbox = [0.02", "wanted a radius, or a box"),
    ],
)
def test_a_scene_that_cannot_be_is_refused_by_name(toml: Path, old: str, new: str, message: str):
    other = toml.with_name("other.toml")
    other.write_text(toml.read_text().replace(old, new))
    with pytest.raises(NeuroAnimatorError, match=message):
        resolve(str(other))


def test_a_mover_that_is_called_as_a_part_of_the_root_is_refused(jelly):
    definition = jelly.scene.definition
    movers = {"velocity": definition.movers["paddle"]}
    named = definition.model_copy(update={"movers": movers})
    scene = Scene(named, jelly.scene.mesh)
    with pytest.raises(
        NeuroAnimatorError,
        match="movers and parameters: two parts are called 'velocity'. Rename one",
    ):
        SoftSystem(named, scene, RestingShapes(jelly.shapes, jelly.rest))


def test_a_solid_is_drawn_with_normals_at_all_nodes(jelly, tmp_path: Path):
    states = moving_states(jelly)[60:70]
    normals = surface_normals(jelly.shapes, jelly.shapes.unplaced(states))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-9)
    clip = na.Clip("jelly", jelly.skeleton, DT * np.arange(10), states)
    na.write_glb(clip, tmp_path / "jelly.glb")
    assert (tmp_path / "jelly.glb").stat().st_size > 0


def test_a_body_over_no_ground_is_refused(jelly):
    definition = jelly.scene.definition.model_copy(update={"ground": None})
    mesh = read_mesh("jelly.msh", msh_4(*cube()).encode())
    with pytest.raises(NeuroAnimatorError, match="falls forever. Add a \\[ground\\]"):
        Scene(definition, mesh)
