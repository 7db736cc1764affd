"""MuJoCo's soft bodies as systems: what nodes and slides say of each other, how they are played, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

import neuroanimator as na
from neuroanimator.definitions.flex import FlexDefinition
from neuroanimator.errors import BadFileError, NeuroAnimatorError
from neuroanimator.files.atomic import canonical_json
from neuroanimator.files.tables import check_table
from neuroanimator.physics.loading import from_text, resolve
from neuroanimator.physics.rigid.compiled_model import compile_model
from neuroanimator.physics.soft.flex_model import mover_names
from neuroanimator.physics.soft.flex_scene import SIDES, FlexScene
from neuroanimator.physics.soft.soft_scene import Motion
from neuroanimator.physics.soft.throws import random_roots
from neuroanimator.scaffold.flex import CARRYING
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.state.rotation import to_world_axes
from neuroanimator.state.shape_contacts import FREE, HELD, ROOT
from neuroanimator.systems.model_files import read_model_files
from neuroanimator.systems.named_files import named_model, named_shapes

BALL = '<body name="ball" mocap="true" pos="0.1 0.3 0.9"><geom size="0.1"/></body>'
HAND = '<body name="hand" mocap="true" pos="-0.1 0 1"><geom size="0.02"/></body>'
TIE = '<equality><connect body1="hand" body2="rope_0" anchor="0 0 0"/></equality>'
ROPE = (
    '<flexcomp name="rope" type="grid" count="6 1 1" spacing="0.04 0.04 0.04" pos="0 0 1" radius="0.01" mass="0.1" dim="1">'
    '<edge equality="true" damping="0.01"/></flexcomp>'
)
CLOTH = (
    '<flexcomp name="cloth" type="grid" count="5 4 1" spacing="0.1 0.1 0.1" pos="0 0 1" euler="90 0 30" radius="0.01" '
    'mass="0.1" dim="2"><edge equality="true"/><pin gridrange="0 3 4 3"/></flexcomp>'
)
JELLY = (
    '<flexcomp name="jelly" type="grid" count="3 3 3" spacing="0.05 0.05 0.05" pos="0 0 0.06" radius="0.005" mass="0.2" '
    'dim="3"><elasticity young="5e3" poisson="0.3" damping="0.002"/><contact selfcollide="none"/></flexcomp>'
)
GROUND = '<geom type="plane" size="2 2 0.1"/>'


def model_of(bodies: str, others: str = "") -> str:
    """Return a model with these bodies in its world."""
    return f'<mujoco><option timestep="0.002"/><worldbody>{bodies}</worldbody>{others}</mujoco>'


KINDS = {
    "rope": model_of(ROPE + HAND, TIE),
    "cloth": model_of(CLOTH + BALL),
    "jelly": model_of(GROUND + JELLY + BALL),
}
ANCHORS = {"rope": 0, "cloth": HELD, "jelly": FREE}


def definition_of(name: str, movers: list[str], **physics: float) -> FlexDefinition:
    values = {
        "name": name,
        "kind": "flex",
        "model": f"{name}.xml",
        "physics": {"step": 0.002, "truth_step": 0.001, "fine_step": 0.0002} | physics,
        "movers": {mover: {"turns": mover == "turning"} for mover in movers},
    }
    return check_table(values, name, FlexDefinition)


def scene_of(kind: str, **physics: float) -> FlexScene:
    model = mujoco.MjModel.from_xml_string(KINDS[kind])
    definition = definition_of(kind, list(mover_names(model)), **physics)
    return FlexScene(definition, f"{kind}.xml", model)


def thrown(scene: FlexScene, seed: int = 0) -> Motion:
    """Return the body slightly out of its reference, and moving."""
    rng = np.random.default_rng(seed)
    changes = 0.01 * rng.normal(size=scene.model.nv)
    rates = 0.1 * rng.normal(size=scene.model.nv)
    slides = scene.body.reference + changes
    return Motion(
        scene.drawn_points(scene.body.placed(slides)), scene.drawn_points(scene.body.moved(rates))
    )


def pushed(scene: FlexScene, frames: int) -> np.ndarray:
    """Return paths of the movers, which go for the body."""
    away = scene.positions.mean(axis=0) - scene.movers.rest[:3]
    return scene.movers.rest + np.linspace(0, 0.7, frames)[:, None] * away


@pytest.mark.parametrize("kind", KINDS)
def test_nodes_follow_from_slides_as_mujoco_says_and_slides_from_nodes(kind: str):
    scene = scene_of(kind)
    slides = scene.body.reference + 0.02 * np.random.default_rng(1).normal(size=scene.model.nv)
    data = mujoco.MjData(scene.model)
    data.qpos[:] = slides
    mujoco.mj_fwdPosition(scene.model, data)
    nodes = scene.body.placed(slides)
    np.testing.assert_allclose(nodes, data.flexvert_xpos, atol=1e-12)
    np.testing.assert_allclose(scene.body.slides(nodes), slides, atol=1e-12)
    assert scene.anchor == ANCHORS[kind]


@pytest.mark.parametrize("kind", KINDS)
def test_a_motion_played_in_two_parts_is_the_same(kind: str):
    scene = scene_of(kind)
    start = thrown(scene)
    paths = pushed(scene, 7)
    positions, velocities = scene.play(start, paths, 0.016, 8)
    first = scene.play(start, paths[:4], 0.016, 8)
    middle = Motion(first[0][-1], first[1][-1]).recentred()
    second = scene.play(middle, paths[3:], 0.016, 8)
    together = np.concatenate([first[0], second[0] + middle.origin])
    np.testing.assert_allclose(together, positions, atol=1e-6)
    np.testing.assert_allclose(np.concatenate([first[1], second[1]]), velocities, atol=1e-4)


def test_bodies_side_by_side_move_as_each_does_alone():
    scene = scene_of("jelly")
    motions = [thrown(scene, seed) for seed in range(3)]
    paths = pushed(scene, 4)
    together = Motion(
        np.stack([motion.positions for motion in motions], axis=-1),
        np.stack([motion.velocities for motion in motions], axis=-1),
    )
    positions, _ = scene.play(together, np.repeat(paths[..., None], 3, axis=-1), 0.016, 8)
    for lane, motion in enumerate(motions):
        np.testing.assert_array_equal(positions[..., lane], scene.play(motion, paths, 0.016, 8)[0])


def test_pins_stay_and_a_carried_rope_goes_with_its_hand():
    cloth = scene_of("cloth")
    path, _ = cloth.play(thrown(cloth), pushed(cloth, 20), 0.016, 8)
    pinned = np.setdiff1d(np.arange(20), cloth.body.nodes)
    assert len(pinned) == 5
    assert (path[:, pinned] == cloth.positions[pinned]).all()
    rope = scene_of("rope", contact_time=0.004)
    hand = rope.movers.rest + np.linspace(0, 0.2, 40)[:, None] * np.array([0, 0, 1.0])
    carried, _ = rope.play(Motion(rope.positions, 0 * rope.positions), hand, 0.016, 8)
    np.testing.assert_allclose(carried[-1, 0], hand[-1], atol=0.03)


def test_harder_contacts_let_less_in():
    depths = []
    for contact_time in (0.0, 0.004):
        scene = scene_of("cloth", contact_time=contact_time)
        paths = pushed(scene, 25)
        path, _ = scene.play(Motion(scene.positions, 0 * scene.positions), paths, 0.016, 8)
        touching = [scene.touching(*at) for at in zip(path, paths[1:], strict=True)]
        assert max(one.contacts.max() for one in touching) > 0
        depths.append(max(one.depths.max() for one in touching))
    assert depths[1] < 0.5 * depths[0]


def test_a_ropes_ribbons_lie_about_its_nodes_and_across_it():
    scene = scene_of("rope")
    nodes = scene.body.placed(scene.body.reference + 0.05)
    drawn = scene.drawn_points(nodes)
    np.testing.assert_array_equal(drawn[: len(nodes)], nodes)  # a node's number is the model's
    points = drawn[len(nodes) :].reshape(-1, SIDES, 3)
    np.testing.assert_allclose(points.mean(axis=1), nodes, atol=1e-12)
    edges = points[1:-1] - nodes[1:-1, None]
    along = nodes[2:] - nodes[:-2]
    np.testing.assert_allclose((edges * along[:, None]).sum(axis=-1), 0, atol=1e-12)
    assert np.linalg.norm(edges, axis=-1).max() == pytest.approx(scene.margin)


def test_a_mover_turns_about_the_vertical():
    model = mujoco.MjModel.from_xml_string(KINDS["jelly"].replace("ball", "turning"))
    scene = FlexScene(definition_of("jelly", ["turning"]), "jelly.xml", model)
    data = mujoco.MjData(scene.model)
    scene.put_movers(data, np.array([1.0, 2.0, 3.0, np.pi / 2]))
    mujoco.mj_kinematics(scene.model, data)
    body = scene.bodies[0]
    np.testing.assert_allclose(data.xpos[body], [1, 2, 3])
    np.testing.assert_allclose(data.xmat[body].reshape(3, 3)[:, 0], [0, 1, 0], atol=1e-12)


def test_a_flex_of_a_mesh_has_the_nodes_of_its_file(tmp_path: Path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "square.obj").write_text(
        "v 0 0 1\nv 0.1 0 1\nv 0.1 0 0.9\nv 0 0 0.9\nf 1 4 3\nf 1 3 2\n"
    )
    square = (
        '<flexcomp name="square" type="mesh" file="square.obj" dim="2" mass="0.1" radius="0.01">'
        '<edge equality="true"/><pin id="0 1"/></flexcomp>'
    )
    xml = model_of(square + BALL).replace("<option", '<compiler meshdir="meshes"/><option')
    (tmp_path / "square.xml").write_text(xml)
    model = compile_model(read_model_files(tmp_path / "square.xml"))
    scene = FlexScene(definition_of("square", ["ball"]), "square.xml", model)
    assert scene.positions.shape == (4, 3)
    assert len(scene.faces) == 2
    assert scene.anchor == HELD


@pytest.fixture(scope="module")
def toml(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flex") / "rope.xml"
    path.write_text(KINDS["rope"])
    written, _ = write_definition(str(path))
    return written


def test_what_lies_inside_the_hand_that_carries_it_does_not_count_as_deep(toml: Path):
    text = toml.read_text()
    assert "0.0 mm deep" in text
    speed = float(text.split("speed = [")[1].split(",")[0])
    assert speed == pytest.approx(CARRYING * 5 * 0.04)


def test_what_new_writes_is_a_system_that_rests_and_whose_states_are_its_nodes(toml: Path):
    rope = na.load_system(str(toml))
    dt = 16 * rope.physics_dt
    controls = np.zeros((1, 5, rope.control.size))
    states = rope.simulate(rope.rest[None], controls, dt).states[0]
    assert np.abs(states - states[0]).max() < 5e-3
    rng = np.random.default_rng(0)
    starts = rope.sample_starts(rng, 1)
    assert (starts[0] == rope.rest).all()
    seen = rope.simulate(starts, rope.sample_paths(rng, 1, 20, dt), dt).states[0, 10:]
    motion = rope.motion(seen)
    size = rope.control.size
    movers = seen[:, :size]
    rates = seen[:, size : 2 * size]
    positions = np.moveaxis(motion.positions + motion.origin, -1, 0)
    again = rope.encode(positions, np.moveaxis(motion.velocities, -1, 0), movers, rates)
    np.testing.assert_allclose(again, seen, atol=2e-3)


def test_a_free_body_begins_at_rest_or_thrown_and_never_under_the_ground():
    scene = scene_of("jelly")
    centre = scene.centre(scene.positions)
    mean = scene.positions - centre
    movers = np.repeat(scene.movers.rest[None], 40, axis=0)
    roots = random_roots(scene, np.random.default_rng(0), mean, centre, movers)
    lying = scene.state_at_rest(centre)[-ROOT:]
    at_rest = 0
    for root in roots:
        assert root is not None
        at_rest += (root == lying).all()
        assert (to_world_axes(root[3:7], mean)[:, 2] + root[2] > scene.ground - 1e-9).all()
    assert 0.2 < at_rest / len(roots) < 0.8


def test_a_cost_of_a_ropes_node_is_of_the_models_node(toml: Path):
    rope = na.load_system(str(toml))
    states = rope.sample_starts(np.random.default_rng(0), 1)
    nodes = rope.motion(states)
    last = nodes.positions[5, :, 0] + nodes.origin[:, 0]
    seen = na.reach_node(rope, 5, [0, 0, 0], within=1).observe(states)[0]
    np.testing.assert_allclose(seen, last, atol=1e-5)
    lengths = np.linalg.norm(np.diff(rope.shapes.decode(rope.rest, range(6)), axis=0), axis=1)
    np.testing.assert_allclose(lengths, 0.04, rtol=0.5)


def test_its_definition_names_model_and_shapes_and_holds_neither(toml: Path):
    name, text, _ = resolve(str(toml))
    files = json.loads(text)["files"]
    assert name == "rope"
    assert set(files) == {"model", "shapes"}
    assert "flexcomp" not in text
    assert named_model(text) is not None
    assert named_shapes(text) is not None
    forged = json.loads(text)
    forged["files"]["model"]["sha256"] = {"rope.xml": "0" * 64}
    with pytest.raises(BadFileError, match=r"'rope.xml' is not what it was trained on"):
        from_text(canonical_json(forged))
    del forged["files"]["shapes"]
    with pytest.raises(BadFileError, match="definition is damaged"):
        from_text(canonical_json(forged))


REFUSED = {
    "2 soft bodies; one is supported": model_of(ROPE + CLOTH + HAND, TIE),
    "0 mocap bodies to be moved": model_of(CLOTH),
    "moved by mocap bodies alone": model_of(
        CLOTH + BALL + '<body><joint name="hinge"/><geom size="0.1"/></body>',
        '<actuator><motor joint="hinge"/></actuator>',
    ),
    "follow a coarser grid": model_of(
        GROUND + JELLY.replace("dim=", 'dof="trilinear" dim=') + BALL
    ),
    "be carried along without inertia": model_of(BALL.replace("</body>", CLOTH + "</body>")),
    "moves by joints, beside the soft body": model_of(
        CLOTH + BALL + '<body name="box" pos="1 1 1"><freejoint/><geom size="0.1"/></body>'
    ),
    "inside a body that moves": model_of(
        '<body name="box" pos="1 1 1"><freejoint/><geom size="0.1"/>' + CLOTH + "</body>" + BALL
    ),
    "is attached to a body that moves": model_of(
        BALL + '<body name="a"><freejoint/><geom size="0.1"/></body><body name="b" pos="1 0 0"/>',
        '<deformable><flex name="f" dim="1" body="a b" vertex="0 0 0 0 0 0" element="0 1"/></deformable>',
    ),
    "falls forever": model_of(JELLY + BALL),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_not_supported_is_refused_with_what_to_do(message: str):
    model = mujoco.MjModel.from_xml_string(REFUSED[message])
    names = list(mover_names(model)) or ["nobody"]
    with pytest.raises(NeuroAnimatorError, match=message) as caught:
        FlexScene(definition_of("refused", names), "refused.xml", model)
    assert "\n" not in str(caught.value)


def test_other_movers_and_another_kind_are_refused(toml: Path, tmp_path: Path):
    (tmp_path / "rope.xml").write_text(KINDS["rope"])
    text = toml.read_text()
    (tmp_path / "rope.toml").write_text(text.replace("[movers.hand]", "[movers.foot]"))
    with pytest.raises(
        NeuroAnimatorError, match=r"wanted the mocap bodies of rope.xml, hand; got 'foot'"
    ):
        na.load_system(str(tmp_path / "rope.toml"))
    rigid = 'name = "rope"\nmodel = "rope.xml"\n[physics]\nstep = 0.002\ntruth_step = 0.001\nfine_step = 0.0002\n'
    (tmp_path / "rope.toml").write_text(rigid)
    with pytest.raises(NeuroAnimatorError, match="it has a soft body"):
        na.load_system(str(tmp_path / "rope.toml"))
    with pytest.raises(NeuroAnimatorError, match="starts at rest as modelled"):
        write_definition(str(tmp_path / "rope.xml"), force=True, keyframe="home")
