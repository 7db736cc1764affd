"""Cloths as systems: what their states say of them, and how they are driven."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from soft_bodies import moving_states

import neuroanimator as na
from neuroanimator.appearance.shapes import COARSE_MODES
from neuroanimator.control.objective.objective import Trajectory
from neuroanimator.control.policies import train_policy
from neuroanimator.control.synthesis.objective_file import read_objective
from neuroanimator.errors import BadFileError, NeuroAnimatorError
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.learn.training.validation import window_errors
from neuroanimator.physics.loading import resolve
from neuroanimator.physics.soft.find_shapes import Sketch
from neuroanimator.physics.soft.mesh_file import read_mesh
from neuroanimator.scaffold.write_toml import write_definition

TUTORIAL = Path(__file__).parents[3] / "docs" / "tutorials" / "my-cloth.md"

SIDE = 12
"""Number of nodes along an edge of the cloth."""


def square_obj(side: int = SIDE) -> str:
    """Return a cloth of 1 m that hangs along -Z, as an OBJ file."""
    line = np.linspace(0, 1, side)
    rows = [f"v {x - 0.5:.4f} 0 {1.5 - z:.4f}" for z in line for x in line]
    for row in range(side - 1):
        for column in range(side - 1):
            first = row * side + column + 1
            rows.append(f"f {first} {first + side} {first + side + 1} {first + 1}")
    return "\n".join(rows) + "\n"


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cloth")
    (folder / "cloth.obj").write_text(square_obj())
    path, _ = write_definition(str(folder / "cloth.obj"))
    text = path.read_text().replace("shapes = 96", "shapes = 48")
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def cloth(toml: Path):
    return na.load_system(str(toml))


def taken_apart(system, states: np.ndarray) -> np.ndarray:
    """Return the states of the nodes of `states`."""
    motion = system.motion(states)
    positions, velocities = (np.moveaxis(part, -1, 0) for part in motion[:2])
    size = system.control.size
    movers, rates = states[:, :size], states[:, size : 2 * size]
    return system.encode(positions, velocities, movers, rates, motion.origin.T)


def test_modes_are_orthogonal_and_of_one_size(cloth):
    modes = cloth.shapes.modes.reshape(len(cloth.shapes.modes), -1)
    products = modes @ modes.T / len(cloth.shapes.mean)
    identity = np.eye(len(modes))
    exact = products[:COARSE_MODES, :COARSE_MODES]
    np.testing.assert_allclose(exact, identity[:COARSE_MODES, :COARSE_MODES], atol=1e-4)
    np.testing.assert_allclose(products, identity, atol=1e-2)


def test_a_state_put_together_and_taken_apart_is_the_same(cloth):
    states = moving_states(cloth)[:5]
    np.testing.assert_allclose(taken_apart(cloth, states), states, atol=1e-3)


def test_pins_are_where_their_mover_is(cloth):
    controls = np.zeros((1, 12, cloth.control.size))
    controls[0, :, 3] = 0.3
    states = cloth.simulate(cloth.rest[None], controls, 1 / 30).states[0]
    moved = states[-1, 3:6] - cloth.rest[3:6]
    np.testing.assert_allclose(moved, [0.3 * 12 / 30, 0, 0], atol=1e-9)
    pins = list(cloth.scene.movers.tables[1].pins)
    where = cloth.shapes.decode(states[-1:], pins)[0] - cloth.shapes.decode(states[:1], pins)[0]
    np.testing.assert_allclose(where, np.broadcast_to(moved, where.shape), atol=5e-3)


def test_rest_stays_rest(cloth):
    controls = np.zeros((1, 30, cloth.control.size))
    states = cloth.simulate(cloth.rest[None], controls, 1 / 30).states[0]
    assert np.abs(states[:, cloth.shapes.amplitudes]).max() < 2e-3


def test_moving_everything_moves_the_motion(cloth):
    """Where the cloth hangs matters to nothing but where it is."""
    rng = np.random.default_rng(0)
    start = moving_states(cloth)[40:41]
    shifted = start.copy()
    shift = np.array([0.5, -0.25, 0.125])
    shifted[:, :6] += np.tile(shift, 2)
    controls = rng.uniform(-0.3, 0.3, (1, 10, cloth.control.size))
    here = cloth.simulate(start, controls, 1 / 30).states
    there = cloth.simulate(shifted, controls, 1 / 30).states
    np.testing.assert_allclose(there[..., 6:], here[..., 6:], atol=5e-3)
    contacts = cloth.structure.shape_contacts
    shown = [contacts.shown(states[0], controls[0, 0], 1 / 30) for states in (start, shifted)]
    np.testing.assert_allclose(np.concatenate(shown[0]), np.concatenate(shown[1]), atol=1e-6)


def test_the_ball_strikes_the_cloth_and_is_shown_beforehand(cloth):
    states = np.repeat(cloth.rest[None], 2, axis=0)
    states[0, :3] = [0.0, 0.175, 1.0]  # a finger's width before the cloth
    states[1, :3] = [0.0, 0.9, 1.0]
    controls = np.zeros((2, 5, cloth.control.size))
    controls[:, :, 1] = -0.5
    ends = cloth.simulate(states, controls, 1 / 30).states[:, -1]
    middle = [SIDE * SIDE // 2 + SIDE // 2]
    struck, left = cloth.shapes.decode(ends, middle)[:, 0, 1]
    assert struck < left - 0.02
    contacts = cloth.structure.shape_contacts
    near = [np.concatenate(contacts.shown(state, controls[0, 0], 1 / 30)[-4:]) for state in states]
    assert np.abs(near[0]).max() > 0.5
    assert not near[1].any()


def test_results_do_not_depend_on_threads_or_on_the_rows_beside(cloth):
    controls = np.random.default_rng(1).uniform(-0.3, 0.3, (20, 4, cloth.control.size))
    starts = moving_states(cloth)[:20]
    one = cloth.simulate(starts, controls, 1 / 30).states
    two = cloth.simulate(starts, controls, 1 / 30, threads=2).states
    few = cloth.simulate(starts[3:5], controls[3:5], 1 / 30).states
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(one[3:5], few)


def test_shapes_are_found_once_and_again_after_a_change(tmp_path: Path):
    (tmp_path / "cloth.obj").write_text(square_obj(4))
    toml, _ = write_definition(str(tmp_path / "cloth.obj"))
    toml.write_text(toml.read_text().replace("shapes = 96", "shapes = 24"))
    name, text, substeps = resolve(str(toml))
    assert (name, substeps) == ("cloth", 40)
    assert resolve(str(toml))[1] == text
    shapes = toml.with_name("cloth.shapes.safetensors")
    before = shapes.read_bytes()
    toml.write_text(toml.read_text().replace("bend = 0.5", "bend = 0.6"))
    resolve(str(toml))
    assert shapes.read_bytes() != before
    toml.write_text(toml.read_text().replace("bend = 0.6", "bend = 0.5"))
    assert resolve(str(toml))[1] == text
    assert shapes.read_bytes() == before


def test_a_sketch_of_blocks_is_the_decomposition_of_all():
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(200, 8)) * 2.0 ** -np.arange(8) @ rng.normal(size=(8, 300))
    sketch = Sketch(16)
    for first in range(0, 200, 40):
        sketch.add(rows[first : first + 40].astype(np.float32))
    found = sketch.leading(8)
    _, _, vectors = np.linalg.svd(rows, full_matrices=False)
    overlap = np.abs(found @ vectors[:8].T)
    np.testing.assert_allclose(overlap, np.eye(8), atol=5e-3)


@pytest.fixture(scope="module")
def trained(toml: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[na.Emulator, Path]:
    folder = tmp_path_factory.mktemp("trained")
    name, text, substeps = resolve(str(toml))
    config = na.DatasetConfig(
        system=name, definition=text, substeps=substeps, count=2880, samples_per_run=36
    )
    na.generate(config, folder / "data")
    data = na.read_transitions(folder / "data")
    settings = na.TrainingConfig(updates=500, batch=128, widths=(32, 32), unroll=1)
    emulator = na.train(data, settings, folder / "run")
    path = folder / "cloth.emulator.safetensors"
    emulator.save(path)
    return emulator, path


def test_an_emulator_of_a_cloth_knows_its_movers_exactly_and_carries_its_shapes(cloth, trained):
    emulator, file = trained
    again = na.Emulator.load(file)
    assert again.skeleton.shapes == cloth.shapes
    controls = np.zeros((6, cloth.control.size), np.float32)
    controls[:, 3] = 0.2
    path = again.rollout(cloth.rest, controls)
    np.testing.assert_array_equal(path, emulator.rollout(cloth.rest, controls))
    np.testing.assert_allclose(path[-1, 3] - path[0, 3], 0.2 * 6 * again.dt, rtol=1e-4)
    np.testing.assert_allclose(path[-1, 6:12], controls[-1], rtol=1e-5)


def test_a_hasty_emulator_of_a_cloth_is_called_what_it_is(cloth, trained):
    """One super step alone says little of it: errors grow."""
    emulator, file = trained
    again = na.Emulator.load(file)
    assert again.validation is not None
    assert str(again.verdict) == str(emulator.verdict)
    window = again.validation.window
    assert window is not None
    assert 0 < float(window.emulator) < 0.2
    assert 0 < float(window.no_change) < 0.2
    assert window.in_words in str(again.verdict)
    rest = np.repeat(cloth.rest[None, None], 9, axis=1)
    held = np.zeros((1, 8, cloth.control.size))
    keeping = window_errors(emulator, rest, held)
    assert keeping is not None
    assert float(keeping.no_change) < 1e-6


def test_a_mover_is_where_its_path_is_and_the_others_stay(trained):
    emulator, _ = trained
    times = np.arange(0, 1.01, 0.01)
    places = np.stack([5 + 0.3 * np.sin(2 * times), 0 * times, 0.2 * times], axis=1)
    drive = na.path_drive(emulator, {"holder": na.RecordedPath("walk", times, places)}, speed=0.5)
    motion = drive.motion(emulator)
    assert not drive.remarks
    assert len(motion) == 61
    at = 0.5 * emulator.dt * np.arange(61)
    expected = np.stack([np.interp(at, times, column) for column in places.T], axis=1)
    np.testing.assert_allclose(motion[:, 3:6], expected, atol=1e-4)
    beside = emulator.rest[:3] - emulator.rest[3:6]
    away = motion[0, :3] - motion[0, 3:6] - beside
    assert np.linalg.norm(away) < 0.2  # the run-in moves the holder away from the ball
    np.testing.assert_allclose(motion[:, :3], np.broadcast_to(motion[0, :3], (61, 3)), atol=1e-4)


def test_a_mover_comes_to_where_its_path_begins_before_the_motion_does(trained):
    emulator, _ = trained
    times = np.array([0.0, 1.0])
    path = na.RecordedPath("ball", times, np.array([[0.5, 0.5, 1.0], [0.5, 0.3, 1.0]]))
    drive = na.path_drive(emulator, {"ball": path}, seconds=0.5)
    np.testing.assert_allclose(drive.start[:3], path.positions[0], atol=1e-6)
    np.testing.assert_allclose(drive.start[3:6], emulator.rest[3:6], atol=1e-5)
    np.testing.assert_allclose(drive.controls[:, :3], [[0, -0.2, 0]] * 15, atol=1e-6)


def test_a_path_faster_than_training_is_told_of_and_one_that_jumps_is_refused(trained):
    emulator, _ = trained
    times = np.array([0.0, 1.0])
    fast = na.RecordedPath("walk", times, np.array([[0.0, 0, 0], [2, 0, 0]]))
    drive = na.path_drive(emulator, {"ball": fast})
    (remark,) = drive.remarks
    assert "ball moves at up to 2 m/s along x, 2 times" in remark
    assert "--path-speed 0.5" in remark
    assert not na.path_drive(emulator, {"ball": fast}, speed=0.5).remarks
    moved = drive.motion(emulator)[-1, :3] - drive.start[:3]
    np.testing.assert_allclose(moved, [2, 0, 0], atol=1e-4)
    jump = na.RecordedPath("walk", times, np.array([[0.0, 0, 0], [200, 0, 0]]))
    with pytest.raises(NeuroAnimatorError, match="200 times as fast as in training"):
        na.path_drive(emulator, {"ball": jump})
    with pytest.raises(NeuroAnimatorError, match="no mover called 'bal'. Did you mean ball"):
        na.path_drive(emulator, {"bal": fast})
    with pytest.raises(NeuroAnimatorError, match=r"wanted at least 3\.33333 s"):
        na.path_drive(emulator, {"ball": fast}, speed=100)


def test_a_policy_of_a_cloth_is_refused_before_it_is_learnt(cloth, trained, tmp_path: Path):
    emulator, _ = trained
    with pytest.raises(NeuroAnimatorError, match="cloth is a soft body"):
        train_policy(emulator, cloth, tmp_path / "cloth.policy.safetensors")
    assert not list(tmp_path.iterdir())


FORGED = {
    "no faces": lambda tensors, _: tensors.pop("shapes.faces"),
    "a face of nodes that are not there": lambda tensors, _: tensors["shapes.faces"].fill(10**6),
    "a mean that is nowhere": lambda tensors, _: tensors["shapes.mean"].fill(np.inf),
    "scales of nothing": lambda tensors, _: tensors["shapes.scales"].fill(0),
    "fewer shapes": lambda tensors, _: tensors.update(
        {"shapes.modes": tensors["shapes.modes"][:-1]}
    ),
    "modes that are no whole numbers": lambda tensors, _: tensors.update(
        {"shapes.modes": tensors["shapes.modes"].astype(np.float32)}
    ),
    "amplitudes beyond the state": lambda _, metadata: metadata["shapes"].update(first=10**4),
    "an anchor beyond the state": lambda _, metadata: metadata["shapes"].update(position=10**4),
    "shapes that are no table": lambda _, metadata: metadata.update(shapes=[]),
    "contacts of no shapes": lambda _, metadata: metadata.pop("shapes"),
    "nodes that are not there": lambda _, metadata: metadata["shape_contacts"]["nodes"].append(
        10**6
    ),
    "more movers": lambda _, metadata: metadata["shape_contacts"].update(turning=[False] * 3),
    "a collider of no mover": lambda _, metadata: metadata["shape_contacts"]["capsules"][
        0
    ].__setitem__(0, 7),
    "a window that is no truth": lambda _, metadata: metadata.update(validation_window=3),
    "a window without numbers": lambda tensors, _: tensors.pop("validation.window.seconds"),
    "an error below nothing": lambda tensors, _: tensors["validation.window.emulator"].fill(-1),
    "a mover that turns": lambda _, metadata: metadata["shape_contacts"].update(
        turning=[False, True]
    ),
    "a body that nothing holds": lambda _, metadata: metadata["shape_contacts"].update(anchor=-1),
    "wind of words": lambda _, metadata: metadata["shape_contacts"].update(wind=["N", 0, 0]),
    "a reach of nothing": lambda _, metadata: metadata["shape_contacts"].update(reach=0),
    "a driven part of another size": lambda _, metadata: metadata["frame"]["segments"][
        0
    ].__setitem__(1, 5),
}
"""By name, a change of an emulator's tensors and metadata."""


@pytest.mark.attack
@pytest.mark.parametrize("name", FORGED)
def test_a_forged_emulator_of_a_cloth_is_refused(trained, tmp_path: Path, name: str):
    found, metadata = read_tensors(trained[1], "emulator")
    tensors = {key: array.copy() for key, array in found.items()}
    FORGED[name](tensors, metadata)
    write_tensors(tmp_path / "forged.safetensors", tensors, metadata)
    with pytest.raises(NeuroAnimatorError) as caught:
        na.Emulator.load(tmp_path / "forged.safetensors")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0\nf 1 2 3\n", "line 1: wanted three numbers"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "line 4: wanted 3 to 256 vertices"),
        ("v 0 0 0\nv 1 0 0\nf 1 2\n", "line 3: wanted 3 to 256 vertices"),
        ("v 0 0 0\n", "no faces"),
        ("#\n" + "v 0 0 0\n" * 100_001, "100,001 nodes, for which 6 GB would be needed"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "line 1: wanted three numbers"),
    ],
)
def test_a_mesh_that_is_none_is_refused_by_line(tmp_path: Path, text: str, message: str):
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(NeuroAnimatorError, match=message):
        write_definition(str(tmp_path / "a.obj"))


def test_an_obj_counts_from_one_and_backwards_and_splits_polygons():
    mesh = read_mesh(
        "a.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1 2/2 3/3 4/4\nf -4 -3 -2\n"
    )
    assert mesh.elements.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]


def test_a_cost_of_a_node_is_of_where_the_node_is(cloth):
    node = SIDE * SIDE - 1
    term = na.reach_node(cloth, node, [0.1, 0.2, 0.3], within=0.5)
    seen = term.observe(moving_states(cloth)[:4])
    np.testing.assert_allclose(
        seen, cloth.shapes.decode(moving_states(cloth)[:4], [node])[:, 0], atol=1e-5
    )
    with pytest.raises(NeuroAnimatorError, match="wanted 0 to 143, got 144"):
        na.reach_node(cloth, SIDE * SIDE, [0, 0, 0], within=1)


def test_an_objective_file_asks_for_a_node_as_python_does(cloth, tmp_path: Path):
    file = tmp_path / "corner.toml"
    text = """system = "cloth"
seconds = 1.0
[[costs]]
kind = "reach_node"
node = 143
position = [0.1, 0.2, 0.3]
within = 0.5
"""
    file.write_text(text)
    states = moving_states(cloth)[:5]
    size = cloth.control.size
    motion = Trajectory(states, np.zeros((4, size)), np.ones(size), 1 / 30)
    meant = na.Objective.of(na.reach_node(cloth, 143, [0.1, 0.2, 0.3], within=0.5))
    found = read_objective(file, cloth).objective
    np.testing.assert_array_equal(found.residuals(motion), meant.residuals(motion))
    file.write_text(text.replace("143", "144"))
    with pytest.raises(
        BadFileError, match=r"cost 1 \(reach_node\): node: wanted 0 to 143, got 144"
    ):
        read_objective(file, cloth)


def test_the_wind_of_a_flag_is_a_parameter_that_no_motion_changes():
    flag, emulator = na.load_system("flag"), na.load_emulator("flag")
    starts = flag.sample_starts(np.random.default_rng(0), 3)
    winds = starts[:, flag.parameter_entries]
    assert len(np.unique(winds)) == 3
    idle = np.zeros((3, 20, flag.control.size))
    runs = flag.simulate(starts, idle, emulator.dt).states
    rollouts = np.asarray(emulator.rollout(starts.astype(np.float32), idle.astype(np.float32)))
    for states in (runs, rollouts):
        held = np.broadcast_to(winds[:, None], (3, 21, 1))
        np.testing.assert_array_equal(
            states[..., flag.parameter_entries], held.astype(states.dtype)
        )
    nodes = [flag.shapes.unplaced(states[:, -1]) for states in (runs, rollouts)]
    gap = np.sqrt(((nodes[0] - nodes[1]) ** 2).sum(axis=-1).mean(axis=-1))
    assert gap.max() < 0.02 * flag.scene.size
    assert list(np.argsort(nodes[1][:, 59, 2])) == list(np.argsort(winds[:, 0]))  # it lifts the tip


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            'breeze = { sets = "air/wind", range = [0.0, 1.0] }',
            r"parameters.breeze.sets: no target called 'air/wind'. Did you mean air/wind_z\? Targets: air/wind_x, ",
        ),
        ('breeze = { sets = "air/wind_y", range = [1.0, 2.0] }', "own value, 0 m/s, got 1 to 2"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused(
    toml: Path, tmp_path: Path, table: str, message: str
):
    path = tmp_path / toml.name
    (tmp_path / "cloth.obj").write_bytes((toml.parent / "cloth.obj").read_bytes())
    path.write_text(f"{toml.read_text()}\n[parameters]\n{table}\n")
    with pytest.raises(NeuroAnimatorError, match=message):
        na.load_system(str(path))


def test_the_tutorials_objective_is_of_the_flags_lower_corner(tmp_path: Path):
    text = TUTORIAL.read_text().split("Save it as `corner.toml`")[1]
    (tmp_path / "corner.toml").write_text(text.split("```toml\n")[1].split("```")[0])
    flag = na.load_system("flag")
    read_objective(tmp_path / "corner.toml", flag)
    corner = flag.shapes.decode(flag.rest, [2399])[0]
    np.testing.assert_allclose(corner, [1.09, 0.03, 0.95], atol=0.005)  # as the tutorial says


def test_controls_that_bring_a_corner_to_a_point_do_so_on_the_physics(cloth, trained):
    """Even a hasty emulator knows that a corner goes with what holds it."""
    emulator, _ = trained
    node = SIDE * SIDE - 1
    corner = cloth.shapes.decode(cloth.rest[None], [node])[0, 0]
    wanted = corner + np.array([0.1, 0.0, 0.0])
    objective = na.Objective.of(na.reach_node(cloth, node, wanted, within=0.02), na.effort(0.01))
    options = na.SearchOptions(refinements=0)
    found = na.synthesise(emulator, cloth, objective, cloth.rest, seconds=1.0, options=options)
    ends = cloth.simulate(cloth.rest[None], found.controls[None], emulator.dt).states[0, -1:]
    there = cloth.shapes.decode(ends, [node])[0, 0]
    assert np.linalg.norm(there - wanted) < 0.6 * np.linalg.norm(corner - wanted)
