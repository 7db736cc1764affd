"""Every integrator of MuJoCo's steps a model here as it does there, or is refused in a line."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

from neuroanimator.errors import BadFileError
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.physics.rigid.mujoco_system import INTEGRATORS
from neuroanimator.scaffold import model as scaffold
from neuroanimator.scaffold.model import propose
from neuroanimator.scaffold.motion import system_of
from neuroanimator.systems.system import Scheme

FLAGS = ("", 'sleep="enable"', 'sleep="enable" island="disable"')


def spring(option: str, flag: str = "", stiffness: float = 20.0) -> str:
    return f"""<mujoco><option {option} gravity="0 0 0"><flag {flag}/></option><worldbody><body>
      <joint name="spring" type="slide" axis="1 0 0" stiffness="{stiffness}"/><geom size="0.1" mass="1"/></body></worldbody>
      <actuator><motor name="push" joint="spring" ctrlrange="-1 1"/></actuator></mujoco>"""


def system_of_model(text: str) -> ModelSystem:
    model = mujoco.MjModel.from_xml_string(text)
    step = float(model.opt.timestep)
    physics = {"step": step, "truth_step": step, "fine_step": step / 10}
    return system_of({"name": "spring", "model": "spring.xml", "physics": physics}, model)


def test_there_is_one_name_for_each_of_mujocos_integrators():
    assert sorted(INTEGRATORS.values(), key=int) == list(mujoco.mjtIntegrator.__members__.values())


def test_new_steps_a_model_by_its_own_integrator(tmp_path: Path):
    path = tmp_path / "spring.xml"
    path.write_text(spring('timestep="0.01" integrator="discrete"'))
    assert propose(path).definition.physics.integrator == "discrete"


def test_an_integrator_that_is_not_known_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "spring.xml"
    path.write_text(spring('integrator="discrete"'))
    known = {name: value for name, value in INTEGRATORS.items() if name != "discrete"}
    monkeypatch.setattr(scaffold, "INTEGRATORS", known)
    with pytest.raises(BadFileError, match=r"spring\.xml: option integrator .* euler, implicit, "):
        propose(path)


@pytest.mark.parametrize("flag", FLAGS)
@pytest.mark.parametrize("solver", ["PGS", "Newton"])
def test_the_integrators_of_a_model_are_those_that_mujoco_steps_it_by(solver: str, flag: str):
    system = system_of_model(spring(f'timestep="0.01" solver="{solver}"', flag))
    for name, integrator in INTEGRATORS.items():
        model = mujoco.MjModel.from_xml_string(spring(f'solver="{solver}"', flag))
        model.opt.integrator = integrator
        able = True
        try:
            mujoco.mj_step(model, mujoco.MjData(model))
        except mujoco.FatalError:
            able = False
        assert (name in system.integrators) == able


def test_a_stiff_spring_stays_within_its_reach_by_the_discrete_integrator_alone():
    system = system_of_model(spring('timestep="0.1"', stiffness=1000.0))
    reached = {}
    for name in system.integrators:
        model = system.model_with(Scheme(name, system.physics_dt))
        data = mujoco.MjData(model)
        data.qpos[0] = 1.0
        reached[name] = 0.0
        for _ in range(6):
            mujoco.mj_step(model, data)
            reached[name] = max(reached[name], abs(float(data.qpos[0])))
    assert [name for name, reach in reached.items() if reach <= 1.0] == ["discrete"]
