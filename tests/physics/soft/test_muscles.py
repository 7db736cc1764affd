"""Laws of a solid with muscles in water, and what is refused of its mesh and definition."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from soft_bodies import hasty_emulator, poses_of
from swimmers import MUSCLES, WATER, mesh_text, mirrored_states, swimmer

import neuroanimator as na
from neuroanimator.animation.motion import random_drive
from neuroanimator.animation.showcase import DIVE
from neuroanimator.control.policies.policy import fresh_policy
from neuroanimator.errors import NeuroAnimatorError
from neuroanimator.files.atomic import read_tensors, write_tensors
from neuroanimator.files.zoo import find_policy
from neuroanimator.physics.soft import constraints
from neuroanimator.physics.soft.mesh_file import read_mesh
from neuroanimator.physics.soft.program import MuscleMotion, SoftProgram
from neuroanimator.physics.soft.soft_body import tetrahedron_volumes
from neuroanimator.physics.water import Water, face_forces, wetness
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.state.body_frame import Frame
from neuroanimator.state.rotation import rotate

DT = 0.032


@pytest.fixture(scope="module")
def trout(tmp_path_factory: pytest.TempPathFactory):
    return na.load_system(str(swimmer(tmp_path_factory.mktemp("trout"))))


def swum(system, controls: np.ndarray, count: int = 1) -> np.ndarray:
    """Return the states (count, T + 1, S) of bodies that begin at rest."""
    starts = np.repeat(system.rest[None], count, axis=0)
    return system.simulate(
        starts, np.broadcast_to(controls, (count, *controls.shape[-2:])), DT
    ).states


def strokes(system, steps: int = 60) -> np.ndarray:
    """Return controls (T, M) that bend the body to and fro, later the farther back."""
    time = np.arange(steps)[:, None] * DT
    lags = np.array([{"f": 0.0, "m": 1.0, "b": 2.0}[name[0]] for name in system.control.names])
    sides = np.array([1.0 if "_l" in name else -1.0 for name in system.control.names])
    return (sides * np.sin(2 * np.pi * 2.5 * time - lags)).clip(0, 1)


def test_muscles_shorten_the_body_and_keep_its_volume(trout):
    body = trout.scene.body
    everything = MuscleMotion(np.ones(12), np.ones((60, 12)))
    still = np.zeros_like(body.positions)
    path, _ = SoftProgram(body).play(
        body.positions, still, poses_of(np.zeros((61, 1, 4))), DT, 16, muscles=everything
    )
    tight = path[-1].astype(float)
    middle = (body.positions[:, 0] < -0.1) & (body.positions[:, 0] > -0.34)
    before, after = (np.ptp(places[middle, 0]) for places in (body.positions, tight))
    assert 0.7 <= after / before <= 0.85  # muscles shorten by 0.3, and the rest resists
    volumes = tetrahedron_volumes(tight, body.tetrahedra)
    assert volumes.sum() == pytest.approx(body.volumes.sum(), rel=0.02)
    assert (volumes > 0).all()


def test_a_body_alone_moves_as_it_does_among_others(trout):
    controls = strokes(trout, 8)
    alone = swum(trout, controls)
    among = swum(trout, controls, count=3)
    for states in among:
        np.testing.assert_allclose(states, alone[0], rtol=1e-9, atol=1e-12)


def test_flesh_is_dark_above_light_below_and_alike_on_both_sides(trout):
    shapes = trout.shapes
    upper, lower = (int((sign * shapes.mean[:, 2]).argmax()) for sign in (1, -1))
    assert shapes.shades[upper] == 1
    assert shapes.shades[lower] == 0
    on_skin = np.unique(shapes.faces)
    partners = np.array(trout.scene.mirror.points)
    np.testing.assert_allclose(shapes.shades[on_skin], shapes.shades[partners[on_skin]], atol=1e-4)
    assert np.ptp(shapes.colours, axis=0).min() > 0.4


def test_activations_follow_their_controls_exactly(trout):
    controls = np.random.default_rng(0).uniform(0, 1, (10, 12))
    active = swum(trout, controls)[0, :, trout.activations]
    left = np.exp(-DT / 0.05)
    for step, control in enumerate(controls):
        np.testing.assert_allclose(active[step + 1], control + left * (active[step] - control))


def test_waves_along_the_body_drive_it_forward_and_more_on_one_side_turn_it(trout):
    straight = swum(trout, strokes(trout))[0]
    assert straight[-1, 0] - straight[0, 0] > 0.1
    assert abs(straight[-1, 1]) < 0.1 * (straight[-1, 0] - straight[0, 0])
    is_left = np.array(["_l" in name for name in trout.control.names])
    left = swum(trout, (strokes(trout) + 0.4 * is_left).clip(0, 1))[0]
    heading = rotate(left[-1, 3:7], np.array([1.0, 0.0, 0.0]))
    assert heading[1] > 0.05  # a body that bends to its left turns left


def test_at_rest_water_carries_the_body_at_any_depth_and_heading(trout):
    deep = trout.rest.copy()
    deep[:3] = [40.0, -7.0, -30.0]
    idle = np.zeros((1, 60, 12))
    after = trout.simulate(deep[None], idle, DT).states[0, -1]
    np.testing.assert_allclose(after[:3], deep[:3], atol=4e-4)
    np.testing.assert_allclose(
        after[trout.shapes.amplitudes], deep[trout.shapes.amplitudes], atol=1e-4
    )


def test_belly_up_it_turns_over(trout):
    over = trout.rest.copy()
    over[3:7] = [np.sin(0.1), np.cos(0.1), 0.0, 0.0]
    after = trout.simulate(over[None], np.zeros((1, 150, 12)), DT).states[0, -1]
    assert rotate(after[3:7], np.array([0.0, 0.0, 1.0]))[2] > 0.9


def test_above_the_surface_it_falls_and_below_it_floats(tmp_path: Path):
    leaper = na.load_system(
        str(
            swimmer(
                tmp_path, "face_drag = 300.0\nrighting = 0.004\nsurface = 0.0\ndepth = 0.05", "", ""
            )
        )
    )
    starts = np.repeat(leaper.rest[None], 2, axis=0)
    starts[:, 2] = [2.0, -2.0]
    states = leaper.simulate(starts, np.zeros((2, 10, 12)), DT).states
    time = 10 * DT
    assert states[0, -1, 2] - 2.0 == pytest.approx(-9.81 / 2 * time**2, rel=0.05)
    assert states[1, -1, 2] == pytest.approx(-2.0, abs=1e-3)


def test_probes_show_the_heights_of_nodes_wherever_shapes_move_them(tmp_path: Path):
    leaper = na.load_system(str(swimmer(tmp_path, f"{WATER}\nsurface = 0.0\ndepth = 0.05")))
    dt = 0.01
    frame = Frame.of(leaper.structure, dt)
    rng = np.random.default_rng(4)
    states = np.repeat(leaper.rest[None], 5, axis=0)
    states[:, 3:7] = rng.normal(size=(5, 4))
    states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1, keepdims=True)
    states[:, 7:13] = rng.normal(size=(5, 6))
    states[:, 13 : leaper.activations.start] = 0.05 * rng.normal(
        size=(5, leaper.activations.start - 13)
    )
    probes = np.array(leaper.structure.probes)[:, :3]
    away = np.linalg.norm(leaper.shapes.mean[:, None] - probes, axis=2)
    nodes = away.argmin(axis=0)
    np.testing.assert_allclose(away.min(axis=0), 0, atol=1e-7)
    assert (np.abs(probes[:, 1]) < 1e-6).all()
    motion = leaper.motion(states)
    heights = np.moveaxis(motion.positions + motion.origin, -1, 0)[:, nodes, 2]
    rising = np.moveaxis(motion.velocities, -1, 0)[:, nodes, 2]
    count = len(nodes)
    shown = frame.local(states)[:, -4 * count :]
    np.testing.assert_allclose(shown[:, :count], heights.clip(-1, 1), atol=1e-6)
    later = (heights + dt * rising).clip(-1, 1)
    np.testing.assert_allclose(shown[:, count : 2 * count], later, atol=1e-6)


def test_an_orca_swims_below_the_surface_and_keeps_its_depth():
    emulator = na.load_emulator("orca")
    states = random_drive(emulator, 4.0, 0).motion(emulator)
    length = np.ptp(emulator.skeleton.shapes.mean[:, 0])
    assert states[0, 2] == pytest.approx(-DIVE * length, rel=1e-3)
    assert abs(states[-1, 2] - states[0, 2]) < 0.01 * length
    assert states[-1, 0] - states[0, 0] > length


def test_the_mirror_image_of_a_motion_is_a_motion(trout):
    is_left_up = np.array(["_lu" in name for name in trout.control.names])
    controls = (strokes(trout) + 0.4 * is_left_up).clip(0, 1)
    partners = list(trout.structure.mirror.controls)
    states = swum(trout, controls)
    images = swum(trout, controls[:, partners])
    apart = np.abs(mirrored_states(trout, states) - images)[0, -1]
    moved = np.abs(states[0, -1] - states[0, 0])
    # Constraints are visited one after another, in an order that is not its own mirror image; visiting those in turn, a body
    # at rest trembles, which drives it.
    assert moved[:2].min() > 0.005
    assert apart[:3].max() < 0.03 * moved[:3].max()
    assert apart[trout.shapes.amplitudes].max() < 0.15 * moved[trout.shapes.amplitudes].max()


def test_an_emulator_is_mirror_symmetric_whatever_its_weights(trout, tmp_path: Path):
    emulator = hasty_emulator(swimmer(tmp_path), tmp_path)
    rng = np.random.default_rng(2)
    states = swum(trout, rng.uniform(0, 1, (8, 12)))[:, 1:].reshape(-1, trout.state.size)
    controls = rng.uniform(0, 1, (len(states), 12))
    partners = list(trout.structure.mirror.controls)
    images = emulator.rollout(mirrored_states(trout, states), controls[:, None, partners])[:, 1]
    expected = mirrored_states(trout, emulator.rollout(states, controls[:, None])[:, 1])
    moved = np.abs(expected - mirrored_states(trout, states)).max()
    np.testing.assert_allclose(images, expected, atol=1e-5 * moved)


def test_water_pushes_triangles_of_solids_as_it_pushes_faces_of_springs():
    rng = np.random.default_rng(3)
    right, up, flow = rng.normal(size=(3, 5, 3))
    heights = np.linspace(-0.1, 0.1, 5)
    water = Water(face_drag=80.0, surface=0.02, depth=0.1)
    expected = face_forces(80.0, right, up, flow, wetness(water, heights))
    for number in range(5):
        told = constraints.water_push(
            *(jnp.asarray(part[number : number + 1]) for part in (right, up, flow, heights)),
            *(jnp.array([value]) for value in (80.0, 0.02, 0.1)),
        )
        np.testing.assert_allclose(told[0], expected[number], rtol=1e-5, atol=1e-6)


def as_version_4(text: str) -> str:
    """Return the same Gmsh file in version 4.1: each group is a volume of its own."""
    lines = text.split("\n")
    names = lines[lines.index("$PhysicalNames") + 2 : lines.index("$EndPhysicalNames")]
    nodes = lines[lines.index("$Nodes") + 2 : lines.index("$EndNodes")]
    rows = [
        line.split() for line in lines[lines.index("$Elements") + 2 : lines.index("$EndElements")]
    ]
    told = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names)), *names]
    told += ["$EndPhysicalNames", "$Entities", f"1 0 0 {len(names) + 1}", "1 0 0 0 0"]
    told += [f"{volume + 100} 0 0 0 1 1 1 1 {volume} 0" for volume in range(1, len(names) + 1)]
    told += ["100 0 0 0 1 1 1 0 0", "$EndEntities"]
    told += ["$Nodes", f"1 {len(nodes)} 1 {len(nodes)}", f"3 1 0 {len(nodes)}"]
    told += [line.split()[0] for line in nodes] + [" ".join(line.split()[1:]) for line in nodes]
    groups = sorted({int(row[3]) for row in rows})
    told += ["$EndNodes", "$Elements", f"{len(groups)} {len(rows)} 1 {len(rows)}"]
    for group in groups:
        members = [row for row in rows if int(row[3]) == group]
        told.append(f"3 {group + 100} 4 {len(members)}")
        told += [" ".join([row[0], *row[5:]]) for row in members]
    return "\n".join([*told, "$EndElements"]) + "\n"


@pytest.mark.parametrize("version", [str, as_version_4])
def test_named_groups_of_tetrahedra_are_read(version):
    mesh = read_mesh("trout.msh", version(mesh_text()).encode())
    assert mesh.groups == tuple(sorted(MUSCLES))
    centres = mesh.positions[mesh.elements].mean(axis=1)
    for number, name in enumerate(mesh.groups):
        inside = centres[mesh.members == number]
        assert len(inside) > 10
        assert ((inside[:, 1] > 0) == ("_l" in name)).all()
    assert (mesh.members == -1).any()


FAULTS = {
    "a muscle that is no group": (
        {"muscles": "front_lu = [1, 0, 0]\nheart = [1, 0, 0]"},
        "no tetrahedra in a group heart",
    ),
    "a direction of no length": (
        {"muscles": "front_lu = [0, 0, 0]"},
        "front_lu has a direction of no length",
    ),
    "a body that sinks": (
        {"water": "face_drag = 300.0\nsurface = 0.0\nbuoyancy = 0.9"},
        "sinks. A density of 900 kg/m³ floats in it: set solid.density = 900 and buoyancy = 1",
    ),
    "a ground": ({"more": "[ground]\nheight = -1.0"}, "swims freely, without movers and ground"),
    "a gait of another muscle": (
        {"more": "[gait]\nperiod = 1.0\n[gait.controls]\nheart = [1.0, 0.0]"},
        "no control called 'heart'",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_definition_is_refused_by_name(fault: str, tmp_path: Path):
    changed, told = FAULTS[fault]
    with pytest.raises(NeuroAnimatorError, match=told):
        na.load_system(str(swimmer(tmp_path, **changed)))


def test_a_mesh_without_groups_says_how_to_name_them(tmp_path: Path):
    toml = swimmer(tmp_path)
    lines = mesh_text().split("\n")
    lines = lines[:3] + lines[lines.index("$EndPhysicalNames") + 1 :]
    (tmp_path / "trout.msh").write_text("\n".join(lines))
    with pytest.raises(NeuroAnimatorError, match=r'Physical Volume\("left"\)'):
        na.load_system(str(toml))


def test_controls_are_from_nothing_to_everything(trout):
    with pytest.raises(NeuroAnimatorError, match="back_ld"):
        swum(trout, np.full((1, 12), 1.5))


def test_a_policy_carries_the_shapes_and_is_read_back(tmp_path: Path):
    emulator = hasty_emulator(swimmer(tmp_path), tmp_path)
    ranges = na.Bounds((0.0, -1.0, -1.0, -1.0), (0.2, 1.0, 1.0, 1.0))
    policy = fresh_policy(emulator, ranges, (8, 8))
    file = tmp_path / "trout.policy.safetensors"
    policy.save(file)
    read = na.Policy.load(file)
    assert read.emulator.skeleton.shapes == emulator.skeleton.shapes
    latent = jnp.asarray(emulator.encode(emulator.rest), jnp.float32)
    moving = (latent, jnp.float32(0.4), jnp.array([0.1, 0.3, 0.0, 0.0], jnp.float32))
    np.testing.assert_array_equal(policy.control(*moving), read.control(*moving))
    idle = np.asarray(policy.control(latent, jnp.float32(0.0), jnp.zeros(4, jnp.float32)))
    assert (idle > 0).all()
    assert (idle < 0.25).all()  # muscles that only pull rest, instead of pulling by half


def test_new_proposes_muscles_from_the_groups_of_a_mesh(tmp_path: Path):
    (tmp_path / "trout.msh").write_text(mesh_text())
    path, proposal = write_definition(str(tmp_path / "trout.msh"))
    definition = proposal.definition
    assert list(definition.muscles.along) == sorted(MUSCLES)
    for direction in definition.muscles.along.values():
        assert abs(direction[0]) > 0.9
    assert definition.water is not None
    assert not definition.movers
    assert "muscles" in dict(proposal.told)
    assert path.read_text().count("[muscles.along]") == 1


def test_new_proposes_a_gait_that_swims_straight_ahead(tmp_path: Path):
    (tmp_path / "trout.msh").write_text(mesh_text())
    path, proposal = write_definition(str(tmp_path / "trout.msh"))
    waves = proposal.definition.gait.controls
    for name, (amplitude, lag) in waves.items():
        mirrored = name[:-2] + {"l": "r", "r": "l"}[name[-2]] + name[-1]
        assert waves[mirrored] == (-amplitude, lag)  # its tail is higher than wide
        assert amplitude == (1 if name[-2] == "l" else -1)
    assert waves["front_lu"][1] < 0.1 < waves["middle_lu"][1] < waves["back_lu"][1] == 1.0
    system = na.load_system(str(path))
    dt = 40 * system.physics_dt
    controls = system.gait.controls(round(3 / dt), dt, system.bounds)
    states = system.simulate_fastest(system.rest[None], controls[None], dt).states[0]
    ahead, aside = states[-1, :2] - states[0, :2]
    assert ahead > 0.7 * system.scene.size
    assert abs(aside) < 0.1 * ahead


def test_muscles_on_one_side_alone_get_no_gait(tmp_path: Path):
    text = mesh_text()
    for name in MUSCLES:
        if not name.endswith("lu"):
            text = text.replace(f'"{name}"', f'"no muscle {name}"')
    (tmp_path / "trout.msh").write_text(text)
    _, proposal = write_definition(str(tmp_path / "trout.msh"))
    assert len(proposal.definition.muscles.along) == 3
    assert proposal.definition.gait is None


MATERIALS = {
    "a name of two words": ('"front_lu"', '"Upper left muscle"'),
    "a name that moves the cursor": ('"front_lu"', '"\\x1b[2Afront"'),
    "a name that is too long": ('"front_lu"', f'"{"front" * 10}"'),
}


@pytest.mark.parametrize("name", MATERIALS)
def test_a_group_whose_name_no_muscle_may_have_is_left_out(name: str, tmp_path: Path):
    old, new = MATERIALS[name]
    text = mesh_text().replace(old, new)
    assert read_mesh("trout.msh", text.encode()).groups == tuple(
        sorted(set(MUSCLES) - {"front_lu"})
    )
    (tmp_path / "trout.msh").write_text(text)
    _, proposal = write_definition(str(tmp_path / "trout.msh"))
    assert len(proposal.definition.muscles.along) == 11


def test_a_single_group_names_the_material_and_is_no_muscle(tmp_path: Path):
    lines = mesh_text().split("\n")
    first, last = lines.index("$PhysicalNames") + 1, lines.index("$EndPhysicalNames")
    (tmp_path / "trout.msh").write_text(
        "\n".join([*lines[:first], "1", '3 1 "gel"', *lines[last:]])
    )
    _, proposal = write_definition(str(tmp_path / "trout.msh"))
    assert proposal.definition.muscles is None
    assert list(proposal.definition.movers) == ["paddle"]


def test_shapes_in_the_file_of_another_body_are_refused(tmp_path: Path):
    file = tmp_path / "fish.policy.safetensors"
    tensors, metadata = read_tensors(find_policy("fish"), "policy")
    write_tensors(file, tensors | {"shapes.mean": np.zeros((3, 3), np.float32)}, metadata)
    with pytest.raises(NeuroAnimatorError, match="shapes: of a body that is not soft"):
        na.Policy.load(file)


BROKEN = {
    "partners that are none": ({"partners": [0] * 12}, "does not pair left and right"),
    "too few partners": ({"partners": [1, 0]}, "does not pair left and right"),
    "a number that is no control": ({"partners": [12, *range(1, 12)]}, "partners"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_file_with_a_wrong_mirror_is_refused(fault: str, tmp_path: Path):
    hasty_emulator(swimmer(tmp_path), tmp_path)
    file = tmp_path / "trout.emulator.safetensors"
    tensors, metadata = read_tensors(file, "emulator")
    changed, told = BROKEN[fault]
    write_tensors(file, tensors, metadata | {"modes": changed})
    with pytest.raises(NeuroAnimatorError, match=told):
        na.load_emulator(file)


def test_a_tetrahedron_in_two_groups_is_refused_with_its_line():
    lines = mesh_text().split("\n")
    last = lines.index("$EndElements")
    count = lines.index("$Elements") + 1
    twin = lines[last - 1].split()
    lines[count] = str(int(lines[count]) + 1)
    lines.insert(last, " ".join([str(int(twin[0]) + 1), *twin[1:]]))
    with pytest.raises(NeuroAnimatorError, match="line [0-9]+: a tetrahedron that comes again"):
        read_mesh("trout.msh", "\n".join(lines).encode())
