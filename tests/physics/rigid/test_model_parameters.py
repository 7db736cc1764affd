"""Parameters of MuJoCo models: a body of a family moves as the same body written out does."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from families import RANGES, TARGETS, parameter_lines, write_arm

from neuroanimator import NeuroAnimatorError, load_system
from neuroanimator.definitions.parts import ParameterTable
from neuroanimator.physics.rigid.model_parameters import ATTRIBUTES, Family
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.systems.system import System

SCALED = """<mujoco><worldbody><body name="trunk" pos="0 0 {z}"><freejoint/>
  <geom name="g" type="box" size="{a} {b} {b}" density="500"/>
  <body name="leg" pos="0 0 {leg}"><joint name="hip" axis="0 1 0" pos="0 0 {hip}"/>
    <geom type="capsule" size="{b} {a}" density="800"/><site name="foot" pos="0 0 {leg}"/></body></body></worldbody></mujoco>"""


def runs_of(system: System, start: np.ndarray) -> np.ndarray:
    controls = np.random.default_rng(0).uniform(-1, 1, (1, 12, 2)) * system.bounds.half
    return system.simulate(start[None], controls, 0.05).states[0]


@pytest.mark.parametrize("name", TARGETS)
def test_a_body_of_the_family_moves_as_the_model_with_that_attribute_does(
    name: str, tmp_path: Path
) -> None:
    value = RANGES[name][0]
    family = load_system(str(write_arm(tmp_path, {}, parameter_lines((name,)))))
    (tmp_path / "single").mkdir()
    single = load_system(str(write_arm(tmp_path / "single", {name: value})))
    start = single.rest + np.array([0.4, -0.3, 1.0, -2.0])
    moved = runs_of(family, np.append(start, value))
    np.testing.assert_allclose(moved[:, :-1], runs_of(single, start), rtol=1e-9, atol=1e-9)
    assert (moved[:, -1] == value).all()


def test_bodies_of_one_batch_move_as_each_alone(tmp_path: Path) -> None:
    family = load_system(str(write_arm(tmp_path, {}, parameter_lines())))
    starts = family.sample_starts(np.random.default_rng(3), 6)
    controls = np.zeros((6, 8, 2))
    together = family.simulate(starts, controls, 0.05, threads=2).states
    for row in range(6):
        alone = family.simulate(starts[row : row + 1], controls[:1], 0.05).states[0]
        np.testing.assert_array_equal(together[row], alone)


def test_starts_are_of_all_bodies_and_at_fixes_some(tmp_path: Path) -> None:
    family = load_system(str(write_arm(tmp_path, {}, parameter_lines())))
    names = [parameter.name for parameter in family.parameters]
    assert names == sorted(TARGETS)
    heavy = family.at(mass=1.3)
    entry = family.parameter_entries.start + names.index("mass")
    assert heavy.rest[entry] == 1.3
    assert family.rest[entry] == 1.0
    starts = heavy.sample_starts(np.random.default_rng(0), 50)
    assert (starts[:, entry] == 1.3).all()
    for place, parameter in enumerate(heavy.parameters):
        values = starts[:, heavy.parameter_entries.start + place]
        assert (values >= parameter.low).all()
        assert (values <= parameter.high).all()
    assert len(np.unique(starts[:, heavy.parameter_entries.start])) == 50


def test_a_scaled_part_is_the_part_with_all_lengths_scaled() -> None:
    factor = 1.3
    lengths = {"a": 0.2, "b": 0.05, "leg": -0.3, "hip": 0.1}
    model = mujoco.MjModel.from_xml_string(SCALED.format(z=1.0, **lengths))
    scaled = {name: factor * length for name, length in lengths.items()}
    wanted = mujoco.MjModel.from_xml_string(SCALED.format(z=1.0, **scaled))
    table = ParameterTable(sets="body/trunk/scale", range=(0.5, 2.0))
    found = Family(model, {"size": table}).model_at(np.array([factor]))
    for field in (
        "body_mass",
        "body_inertia",
        "body_ipos",
        "body_pos",
        "body_subtreemass",
        "geom_size",
        "geom_pos",
        "geom_rbound",
        "jnt_pos",
        "site_pos",
        "dof_invweight0",
    ):
        np.testing.assert_allclose(
            getattr(found, field), getattr(wanted, field), rtol=1e-6, err_msg=field
        )


@pytest.mark.parametrize(
    "actuator",
    [
        '<position name="b" joint="b" kp="3" kv="0.2"/>',
        '<pid name="b" joint="b" kp="3" kv="0.2" ki="0.5" imax="1" input="pos vel"/>',
    ],
)
def test_every_attribute_is_read_as_it_was_set(actuator: str) -> None:
    text = """<mujoco><worldbody><body name="b" simple="false"><joint name="b" axis="0 1 0" damping="1" armature="0.1"
      frictionloss="0.1" stiffness="1" limited="true" range="-1 1"/>
      <geom name="b" type="box" size=".3 .3 .3" mass="6.67"/></body><geom name="floor" type="plane" size="1 1 1"/></worldbody>
      <contact><pair name="b" geom1="b" geom2="floor"/></contact>
      <tendon><fixed name="b" stiffness="1" damping="1"><joint joint="b" coef="1"/></fixed></tendon>
      <actuator>OTHER</actuator></mujoco>"""
    # An actuator before it has several controls and forces.
    several = '<orientation joint="ball" kp="1" input="quat"/>'
    text = text.replace("OTHER", several + actuator)
    text = text.replace(
        "<worldbody>", '<worldbody><body><joint name="ball" type="ball"/><geom size="1"/></body>'
    )
    model = mujoco.MjModel.from_xml_string(text, {})
    for element, attributes in ATTRIBUTES.items():
        for name, attribute in attributes.items():
            if name in ("scale", "inertia_factor"):  # multiples of what a model has
                continue
            index = "" if attribute.default is not None else "[1]"
            element_name = "" if element == "option" else "b/"
            table = ParameterTable(
                sets=f"{element}/{element_name}{name}{index}", range=(-1e3, 1e3), nominal=0.0
            )
            if attribute.least > -np.inf:
                table = table.model_copy(update={"range": (0.2, 1e3), "nominal": 1.0})
            if name == "inertia":  # else it exceeds the sum of the others
                table = table.model_copy(update={"range": (0.35, 0.45), "nominal": 0.4})
            if name == "range":
                table = table.model_copy(update={"range": (0.35, 0.45), "nominal": 0.4})
            family = Family(model, {"p": table})
            changed = family.model_at(np.array([0.4]))
            target = family._targets[0]
            assert target.read(changed) == pytest.approx(0.4), (element, name)


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ('m = { sets = "body/uper/mass", range = [0.5, 2] }', "Did you mean upper"),
        (
            'm = { sets = "body/upper/colour", range = [0.5, 2] }',
            "body: no attribute called 'colour'. Attributes: mass",
        ),
        ('m = { sets = "mass", range = [0.5, 2] }', "element/name/attribute"),
        ('m = { sets = "body/upper/mass", range = [-0.5, 2] }', "wanted above 0"),
        ('m = { sets = "body/upper/mass", range = [2, 0.5] }', "least value below"),
        ('m = { sets = "body/upper/mass", range = [2, 3] }', "the body's own value, 1 kg"),
        ('m = { sets = "body/upper/pos", range = [-1, 1] }', "pos[0] to [2]"),
        ('m = { sets = "body/upper/inertia[0]", range = [1e-3, 10] }', "exceeds the sum"),
        ('m = { sets = "joint/elbow/range[0]", range = [-3, 3] }', "inverted"),
        (
            'shoulder = { sets = "body/upper/mass", range = [0.5, 2] }',
            "two parts are called 'shoulder'",
        ),
        ('m = { sets = "body/upper/mass", range = [0.5, inf] }', "finite"),
        ('m = { sets = "joint/damping", range = [0.1, 0.3] }', "differ, from 0.1 to 0.2"),
        ('m = { sets = "body/gravcomp", range = [0, 1] }', "no body called ''"),
    ],
)
def test_a_body_that_cannot_be_is_refused_by_name(line: str, wanted: str, tmp_path: Path) -> None:
    path = write_arm(tmp_path, {}, f"\n[parameters]\n{line}\n")
    with pytest.raises(NeuroAnimatorError) as error:
        load_system(str(path))
    assert wanted in str(error.value)
    assert "\n" not in str(error.value)


def test_trucks_of_a_family_slide_and_weigh_as_their_model_written_out_does(tmp_path: Path) -> None:
    """All four pairs of tyre and ground get the friction of their body."""
    path = tmp_path / "trucks.toml"
    path.write_text(
        'name = "trucks"\nfamily_of = "truck"\n[parameters]\n'
        'mass = { sets = "body/chassis/mass", range = [1050, 1950] }\n'
        'friction = { sets = "pair/friction", range = [0.5, 1] }\n'
    )
    trucks = load_system(str(path))
    truck = load_system("truck")
    assert isinstance(truck, ModelSystem)
    assert isinstance(trucks, ModelSystem)
    turning = np.tile([2000.0, 0.6], (1, 20, 1))

    def driven(friction: float) -> np.ndarray:
        start = trucks.at(friction=friction).rest
        return trucks.simulate(start[None], turning, 0.1).states[0, -1]

    own = truck.simulate(truck.rest[None], turning, 0.1).states[0, -1]
    np.testing.assert_allclose(driven(0.8)[:-2], own, rtol=1e-9, atol=1e-9)
    assert np.abs(driven(0.5)[:2] - own[:2]).max() > 0.05
    slippery = trucks.family.model_at(np.array([0.5, 1500.0]))
    np.testing.assert_array_equal(slippery.pair_friction[:, :2], 0.5)
