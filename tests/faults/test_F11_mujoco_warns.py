"""F11: runs that diverge are counted and explained in one line, and leave nothing in the user's folder."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
from conftest import Cli

from neuroanimator import load_system
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.physics.rigid.warnings import (
    shortened,
    warning_line,
    warnings_counted,
    warnings_heard,
)

STIFF = """\
<mujoco model="stiff">
  <option timestep="0.02" integrator="Euler"/>
  <worldbody>
    <body>
      <joint name="hinge" axis="0 1 0" stiffness="1e9"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="0.3"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""

WILD_TOML = """\
name = "stiff"
model = "stiff.xml"
substeps = 5
[physics]
step = 0.02
truth_step = 0.02
fine_step = 0.002
[sampling.velocity]
hinge = [1e4]
"""


def warns(system: MujocoSystem, runs: int = 40, threads: int = 2) -> np.ndarray:
    """Return which of `runs` from impossible speeds survived."""
    starts = np.tile(system.rest, (runs, 1))
    starts[::2, system.model.nq :] = 1e12
    return system.simulate(
        starts, np.zeros((runs, 5, system.control.size)), 0.05, threads=threads
    ).has_diverged


def test_warnings_of_all_threads_are_counted_and_not_printed(tmp_path: Path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    system = load_system("lander")
    assert isinstance(system, MujocoSystem)
    before = warnings_heard().total()
    has_diverged = warns(system)
    assert has_diverged.tolist() == [True, False] * 20
    assert warnings_heard().total() >= before + 20
    assert not list(tmp_path.iterdir())
    assert "WARNING" not in "".join(capfd.readouterr())
    assert re.fullmatch(
        r"MuJoCo warned [\d,]+ times: Nan, Inf or huge value in Q\w+.* were dropped, or .*",
        warning_line(),
    )


def test_somebody_elses_handler_is_back_afterwards_even_after_an_error():
    heard: list[str] = []
    mujoco.set_mju_user_warning(heard.append)
    try:
        with warnings_counted, warnings_counted:
            assert mujoco.get_mju_user_warning() != heard.append
        assert mujoco.get_mju_user_warning() == heard.append
        try:
            with warnings_counted:
                raise RuntimeError
        except RuntimeError:
            pass
        assert mujoco.get_mju_user_warning() == heard.append
    finally:
        mujoco.set_mju_user_warning(None)


def test_warnings_that_differ_in_time_and_joint_alone_are_one_kind():
    text = "Nan, Inf or huge value in QACC at DOF {}. The simulation is unstable. Time = {}."
    assert shortened(text.format(3, "0.0000")) == shortened(text.format(12, "1.2e+07"))
    assert shortened(text.format(3, "0.0000")) == "Nan, Inf or huge value in QACC"


def test_generate_says_once_what_mujoco_warned_of_and_leaves_no_log(
    cli_process: Cli, tmp_path: Path
):
    (tmp_path / "stiff.xml").write_text(STIFF)
    (tmp_path / "stiff.toml").write_text(WILD_TOML)
    result = cli_process("generate", "stiff.toml", "--count", "600", "--out", "data", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert "WARNING" not in result.stdout
    assert re.fullmatch(
        r"neuroanimator: MuJoCo warned [\d,]+ times: Nan, .* were dropped, or .*\n", result.stderr
    )
