"""Where a root stands does not matter only if nothing else can tell."""

from __future__ import annotations

import mujoco
import pytest

from neuroanimator.scaffold.root_invariance import (
    can_touch_ground,
    has_contacts,
    is_placeless,
    planar_root,
    why_root_is_placed,
)

SHAPE = '<geom type="box" size="0.1 0.1 0.1" mass="1"/>'
FREE = SHAPE.replace("/>", ' contype="0" conaffinity="0"/>')


def slider(name: str, shape: str = FREE, joint: str = "") -> str:
    return (
        f'<body name="{name}" pos="0 0 1"><joint name="{name}" type="slide" axis="1 0 0" {joint}/>'
        f'{shape}<site name="{name}"/></body>'
    )


def model(bodies: str, rest: str = "", option: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(
        f"<mujoco>{option}<worldbody>{bodies}</worldbody>{rest}</mujoco>"
    )


def test_a_slide_by_itself_stands_anywhere():
    assert is_placeless(model(slider("a")), 0)
    assert is_placeless(model(slider("a") + slider("b")), 1)


ROPE = '<tendon><spatial stiffness="9"><site site="a"/><site site="b"/></spatial></tendon>'
WELD = '<equality><connect site1="a" site2="b"/></equality>'
GEARS = '<equality><joint joint1="a" joint2="b"/></equality>'
SERVO = '<actuator><position joint="a" kp="9"/></actuator>'
WALL = '<geom type="plane" size="1 1 1" pos="-2 0 0" zaxis="1 0 0"/>'
POST = '<geom type="capsule" size="0.1 1" pos="3 0 0"/>'


@pytest.mark.parametrize(
    ("bodies", "rest"),
    [
        (slider("a") + slider("b"), ROPE),
        (slider("a") + slider("b"), WELD),
        (slider("a") + slider("b"), GEARS),
        (slider("a", SHAPE) + slider("b", SHAPE), ""),
        (slider("a", SHAPE) + WALL, ""),
        (slider("a", SHAPE) + POST, ""),
        (slider("a"), SERVO),
        (slider("a", joint='stiffness="3"'), ""),
        (slider("a", joint='range="-1 1" limited="true"'), ""),
    ],
    ids=["rope", "connect", "gears", "two bodies", "wall", "post", "servo", "spring", "range"],
)
def test_whatever_can_tell_where_a_slide_stands_makes_it_matter(bodies: str, rest: str):
    assert not is_placeless(model(bodies, rest), 0)


def test_a_floor_along_the_slide_tells_nothing():
    floor = '<geom type="plane" size="1 1 1"/>'
    assert is_placeless(model(slider("a", SHAPE) + floor), 0)


def test_flags_and_exclusions_decide_what_can_touch():
    both = slider("a", SHAPE) + slider("b", SHAPE)
    assert has_contacts(model(both))
    assert not can_touch_ground(model(both))
    assert not has_contacts(model(both, '<contact><exclude body1="a" body2="b"/></contact>'))
    for flag in ("contact", "constraint"):
        off = f'<option><flag {flag}="disable"/></option>'
        assert not has_contacts(model(both, option=off))
        assert is_placeless(model(both, option=off), 0)
    hanging = '<body name="{}"><joint axis="0 1 0"/>' + SHAPE
    chain = hanging.format("up") + hanging.format("low") + "</body></body>"
    assert not has_contacts(model(chain))


PLANAR = (
    '<body name="r"><joint name="x" type="slide" axis="1 0 0" {}/><joint name="y" type="slide" axis="0 1 0"/>'
    '<joint name="h" axis="0 0 1"/>' + FREE + "</body>"
)


def test_a_root_is_planar_only_if_its_heading_does_not_matter():
    assert planar_root(model(PLANAR.format(""))) == ("x", "y", "h")
    assert planar_root(model(PLANAR.format('damping="1"'))) == ()
    # A motor on a slide pushes along the world's axis, wherever the body heads.
    assert planar_root(model(PLANAR.format(""), '<actuator><motor joint="x"/></actuator>')) == ()
    turned = '<actuator><motor joint="h"/></actuator>'
    assert planar_root(model(PLANAR.format(""), turned)) == ("x", "y", "h")


@pytest.mark.parametrize(
    "option",
    ["", 'gravity="1 0 -9"', 'wind="3 0 0" density="1000"'],
    ids=["plain", "slope", "wind"],
)
def test_the_heading_of_a_free_root_matters_where_the_world_pushes_it_to_one_side(option: str):
    free = f'<body><freejoint/>{SHAPE}<site name="a"/></body>'
    is_pushed = bool(why_root_is_placed(model(free, option=f"<option {option}/>")))
    assert is_pushed == bool(option)


def test_ropes_and_thrusters_tell_where_a_free_root_is():
    free = f'<body><freejoint/>{SHAPE}<site name="a"/></body><site name="b"/>'
    assert not why_root_is_placed(model(free))
    assert why_root_is_placed(model(free, ROPE))
    assert not why_root_is_placed(model(free, '<actuator><motor site="a"/></actuator>'))
    along_the_world = '<actuator><motor site="a" refsite="b" gear="1 0 0 0 0 0"/></actuator>'
    assert why_root_is_placed(model(free, along_the_world))
