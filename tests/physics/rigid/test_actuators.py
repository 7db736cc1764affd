"""Controls of actuators: each has one name, acts on what its actuator moves, and means what MuJoCo says."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator.errors import ArgumentError
from neuroanimator.gym.read_motion import _servoed
from neuroanimator.physics.rigid.actuators import control_names, layout_of_controls
from neuroanimator.physics.rigid.limbs import acts_on
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.scaffold.model import propose
from neuroanimator.scaffold.motion import system_of

ACTUATORS = {
    "motor": ('<motor name="motor" joint="hinge"/>', [""]),
    "servo": ('<position name="servo" joint="slide" kp="2"/>', [""]),
    "pid": (
        '<pid name="pid" joint="hinge" kp="2" kv="1" input="pos vel ff"/>',
        ["_pos", "_vel", "_ff"],
    ),
    "pd": ('<pid name="pd" joint="slide" kp="2" kv="1" input="vel"/>', [""]),
    "drive": (
        '<dcmotor name="drive" joint="hinge" motorconst="1" resistance="1" controller="1" input="pos voltage"/>',
        ["_pos", "_voltage"],
    ),
    "brake": (
        '<dcmotor name="brake" joint="hinge" motorconst="1" resistance="1" input="none"/>',
        [],
    ),
    "turn": (
        '<orientation name="turn" joint="ball" kp="2" input="quat"/>',
        ["_w", "_x", "_y", "_z"],
    ),
    "aim": ('<orientation name="aim" joint="ball" kp="2"/>', ["_x", "_y", "_z"]),
    "thruster": ('<motor name="thruster" site="tip" gear="1 0 0 0 0 0"/>', [""]),
}
"""An actuator of each kind, and what its controls are called beyond its name."""


def model_with(actuators: str) -> str:
    return f"""<mujoco><option timestep="0.005"/><worldbody>
      <body><joint name="slide" type="slide" axis="1 0 0"/><geom size="0.1"/></body>
      <body pos="0 0 2"><joint name="hinge" axis="0 1 0" damping="1"/><geom size="0.1" pos="0.2 0 0"/>
      <site name="tip" pos="0 0 0.3"/></body>
      <body pos="0 0 4"><joint name="ball" type="ball" damping="1"/><geom type="box" size="0.1 0.2 0.3"/></body></worldbody>
      <actuator>{actuators}</actuator></mujoco>"""


def drawn_models() -> list[tuple[list[str], mujoco.MjModel]]:
    """Return models with some of the actuators in any order."""
    rng = np.random.default_rng(0)
    drawn = []
    for count in range(2, len(ACTUATORS) + 1):
        names = rng.permutation(list(ACTUATORS))[:count].tolist()
        text = model_with("".join(ACTUATORS[name][0] for name in names))
        drawn.append((names, mujoco.MjModel.from_xml_string(text)))
    return drawn


def forces(model: mujoco.MjModel, controls: np.ndarray) -> np.ndarray:
    """Return the force of all actuators on each degree of freedom, somewhere off the reference pose."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 0.1)
    data.qvel[:] = rng.normal(size=model.nv)
    data.ctrl[:] = controls
    mujoco.mj_forward(model, data)
    return np.array(data.qfrc_actuator)


def test_each_control_has_the_name_of_its_actuator_and_of_its_input():
    for names, model in drawn_models():
        expected = [f"{name}{end}" for name in names for end in ACTUATORS[name][1]]
        assert control_names(model) == expected
        assert layout_of_controls(model).size == model.nu


def test_a_control_acts_on_the_freedoms_that_it_pushes():
    for _, model in drawn_models():
        controls = np.random.default_rng(2).uniform(0.2, 1, model.nu)
        acting = acts_on(model)
        assert acting.shape == (model.nu, model.nv)
        for control, freedoms in enumerate(acting):
            other = controls.copy()
            other[control] += 0.5
            pushed = np.abs(forces(model, other) - forces(model, controls)) > 1e-9
            assert not (pushed & ~freedoms).any()
            assert pushed.any()


def test_units_are_those_of_the_inputs():
    text = model_with(ACTUATORS["pid"][0] + ACTUATORS["pd"][0] + ACTUATORS["turn"][0])
    layout = layout_of_controls(mujoco.MjModel.from_xml_string(text))
    assert [part.unit for part in layout.slices] == ["rad", "rad/s", "N·m", "m/s", *"1111"]


def test_a_name_that_two_controls_would_have_is_refused():
    text = model_with(ACTUATORS["turn"][0] + '<motor name="turn_x" joint="hinge"/>')
    with pytest.raises(ArgumentError, match="actuators: two parts are called 'turn_x'"):
        layout_of_controls(mujoco.MjModel.from_xml_string(text))


def test_new_proposes_a_range_for_each_control(tmp_path: Path):
    path = tmp_path / "model.xml"
    path.write_text(model_with("".join(ACTUATORS[name][0] for name in ("turn", "brake", "pid"))))
    definition = propose(path).definition
    assert list(definition.control) == [
        "turn_w",
        "turn_x",
        "turn_y",
        "turn_z",
        "pid_pos",
        "pid_vel",
        "pid_ff",
    ]
    assert all(low < high for low, high in definition.control.values())


@pytest.mark.parametrize("name", ["pid", "pd", "drive", "brake", "turn"])
def test_a_servo_of_several_inputs_follows_no_motion(name: str):
    model = mujoco.MjModel.from_xml_string(model_with(ACTUATORS[name][0] + ACTUATORS["servo"][0]))
    control = dict.fromkeys(control_names(model), (-1.0, 1.0))
    physics = {"step": 0.005, "truth_step": 0.005, "fine_step": 0.0005}
    system = system_of(
        {"name": "model", "model": "m.xml", "physics": physics, "control": control}, model
    )
    assert isinstance(system, ModelSystem)
    with pytest.raises(ArgumentError, match=f"actuator '{name}' is no servo of a joint"):
        _servoed(system)
