"""Models whose parts are tied together, and what each of their states must satisfy."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from neuroanimator.definitions.model import Definition
from neuroanimator.physics.rigid.model_system import ModelSystem

GAP = 1e-4
"""Largest residual of an equality [m or rad]: MuJoCo keeps a four-bar linkage to twice that as it moves."""

BEYOND = 1e-4
"""Largest angle or distance of a joint beyond its limits [rad or m]."""

OPENING = 1e-6
"""Largest velocity at which an equality opens [m/s or rad/s]."""

FOUR_BAR = """<worldbody>
  <body name="crank" pos="0 0 0.5"><joint name="crank"/><geom type="capsule" fromto="0 0 0 0.1 0 0" mass="0.1"/>
    <body name="rod" pos="0.1 0 0"><joint name="rod"/><geom type="capsule" fromto="0 0 0 0.25 0 0.15" mass="0.1"/></body>
  </body>
  <body name="rocker" pos="0.35 0 0.45"><joint name="rocker"/><geom type="capsule" fromto="0 0 0 0 0 0.2" mass="0.1"/></body>
</worldbody>
<equality><connect name="loop" body1="rod" body2="rocker" anchor="0.25 0 0.15"/></equality>
<actuator><motor name="crank" joint="crank" ctrlrange="-0.2 0.2"/></actuator>"""

FINGERS = """<worldbody>
  <body pos="0 0 1"><joint name="left" range="0 0.8" limited="true"/><geom size="0.02" pos="0.1 0 0"/></body>
  <body pos="0 1 1"><joint name="right" range="-0.9 0.9" limited="true"/><geom size="0.02" pos="0.1 0 0"/></body>
  <body pos="0 2 1"><joint name="tip" range="-2 2" limited="true"/><geom size="0.02" pos="0.1 0 0"/></body>
</worldbody>
<equality>
  <joint name="mirrored" joint1="right" joint2="left" polycoef="0.05 -1 0 0 0"/>
  <joint name="bent" joint1="tip" joint2="right" polycoef="0 0.5 0.8 0 0"/>
</equality>
<actuator><motor name="m" joint="left" ctrlrange="-1 1"/></actuator>"""

TENDONS = """<worldbody>
  <body pos="0 0 1"><joint name="a"/><geom size="0.02" pos="0.1 0 0"/></body>
  <body pos="0 1 1"><joint name="b"/><geom size="0.02" pos="0.1 0 0"/></body>
  <body pos="0 2 1"><joint name="c" type="slide"/><geom size="0.02" pos="0.1 0 0"/></body>
</worldbody>
<tendon>
  <fixed name="one"><joint joint="a" coef="1"/><joint joint="b" coef="-2"/></fixed>
  <fixed name="two"><joint joint="b" coef="1"/><joint joint="c" coef="3"/></fixed>
</tendon>
<equality>
  <tendon name="tied" tendon1="one" tendon2="two" polycoef="0.1 0.5 0.2 0 0"/>
  <joint name="off" joint1="c" polycoef="9 0 0 0 0" active="false"/>
</equality>
<actuator><motor name="m" joint="a" ctrlrange="-1 1"/></actuator>"""

WELD = """<worldbody>
  <body name="arm" pos="0 0 1"><joint name="arm"/><geom size="0.02" pos="0.3 0 0"/>
    <body name="hand" pos="0.3 0 0"><joint name="hand" axis="0 0 1"/><geom size="0.02" pos="0.3 0 0"/></body></body>
  <body name="load" pos="0.8 0.1 1"><freejoint name="load"/><geom type="box" size="0.03 0.03 0.03"/></body>
</worldbody>
<equality><weld name="grip" body1="hand" body2="load" relpose="0.35 0 0 0.8 0 0.6 0"/></equality>
<actuator><motor name="arm" joint="arm" ctrlrange="-1 1"/></actuator>"""


def delta_robot() -> str:
    """Return a parallel robot: three arms, whose forearms turn in balls, carry one plate."""
    arms = ""
    loops = ""
    for number in range(3):
        turn = 2 * np.pi * number / 3
        place = f"{0.1 * np.cos(turn)} {0.1 * np.sin(turn)} 0.6"
        arms += (
            f'<body euler="0 0 {turn}" pos="{place}"><joint name="arm{number}" range="-1 1" limited="true"/>'
            f'<geom size="0.01" pos="0.1 0 0"/><body name="forearm{number}" pos="0.1 0 0">'
            f'<joint name="forearm{number}" type="ball"/><geom size="0.01" pos="-0.15 0 -0.25"/></body></body>'
        )
        loops += f'<connect name="loop{number}" body1="forearm{number}" body2="plate" anchor="-0.15 0 -0.25"/>'
    slides = "".join(
        f'<joint name="{name}" type="slide" axis="{axis}"/>'
        for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1"))
    )
    return (
        f'<worldbody>{arms}<body name="plate" pos="0 0 0.35">{slides}<geom size="0.05"/></body></worldbody>'
        f'<equality>{loops}</equality><actuator><motor name="m" joint="arm0" ctrlrange="-1 1"/></actuator>'
    )


MODELS = {
    "four-bar linkage": FOUR_BAR,
    "gripper": FINGERS,
    "tendons": TENDONS,
    "weld": WELD,
    "parallel robot": delta_robot(),
}


def model_of(inside: str) -> str:
    """Return an MJCF model whose bodies collide with nothing."""
    return (
        '<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><default>'
        '<geom contype="0" conaffinity="0" size="0.01" mass="0.1"/><joint axis="0 1 0" damping="0.002"/></default>'
        f"{inside}</mujoco>"
    )


def system_of(inside: str, **sampling: object) -> ModelSystem:
    """Return the system of a model, whose joints start anywhere within their ranges, quickly."""
    model = mujoco.MjModel.from_xml_string(model_of(inside))
    position: dict[str, object] = {}
    velocity = {}
    for number in range(model.njnt):
        name = model.joint(number).name
        freedoms = int(np.count_nonzero(model.dof_jntid == number))
        velocity[name] = (3.0,) * freedoms
        if freedoms == 6:
            continue
        position[name] = 1.0 if freedoms == 3 else 3.0
        if model.jnt_limited[number] and freedoms == 1:
            position[name] = tuple(model.jnt_range[number])
    physics = {"step": 0.002, "truth_step": 0.002, "fine_step": 0.0002}
    table = {"position": position, "velocity": velocity} | sampling
    definition = Definition.model_validate(
        {"name": "m", "model": "m.xml", "physics": physics, "sampling": table}
    )
    return ModelSystem(definition, model)


def assert_closed(system: ModelSystem, states: Float[np.ndarray, "N S"]) -> None:
    """Hold states against MuJoCo's own reading of the equalities, and of the joints' limits."""
    model = system.model
    data = mujoco.MjData(model)
    for state in states:
        system.put(data, state)
        mujoco.mj_forward(model, data)
        gaps = np.abs(data.efc_pos[: data.ne])
        opening = np.abs(data.efc_vel[: data.ne])
        assert gaps.max() < GAP, gaps
        assert opening.max() < OPENING, opening
        is_limit = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
        assert np.all(data.efc_pos[is_limit] > -BEYOND)
