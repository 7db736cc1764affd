"""Models that MuJoCo cannot compile or simulate end no process and leave no file: each is one line."""

from __future__ import annotations

import struct
from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator import load_system
from neuroanimator.errors import BadFileError
from neuroanimator.executor.limited import ProcessLimits
from neuroanimator.physics.rigid import compiled_model
from neuroanimator.physics.rigid.compiled_model import compile_model
from neuroanimator.physics.rigid.mujoco_system import MujocoSystem
from neuroanimator.systems.model_files import ModelFiles

TOML = """
name = "balls"
model = "balls.xml"
[physics]
step = 0.002
truth_step = 0.002
fine_step = 0.0002
"""

MOTOR = '<actuator><motor joint="j0" ctrlrange="-1 1" ctrllimited="true"/></actuator>'


def balls(count: int, size: str) -> str:
    """Return a model of balls on one axis that all touch, with the <size> given."""
    each = (
        '<body pos="{x} 0 0"><joint name="j{i}" type="slide" axis="1 0 0"/><geom size=".1"/></body>'
    )
    bodies = "".join(each.format(x=i * 0.001, i=i) for i in range(count))
    return f"<mujoco>{size}<worldbody>{bodies}</worldbody>{MOTOR}</mujoco>"


def model(text: str, **files: bytes) -> ModelFiles:
    stored = {"m.xml": text.encode(), **files}
    return ModelFiles("m.xml", tuple(stored.items()))


def test_a_small_working_memory_of_a_model_is_no_fault(tmp_path: Path):
    (tmp_path / "balls.xml").write_text(balls(100, '<size memory="100K"/>'))
    (tmp_path / "balls.toml").write_text(TOML)
    system = load_system(str(tmp_path / "balls.toml"))
    starts = np.tile(system.rest, (4, 1))
    runs = system.simulate(starts, np.zeros((4, 2, 1)), 0.01, threads=2)
    assert np.isfinite(runs.states).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_a_fatal_error_of_mujoco_is_an_error_on_any_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
):
    monkeypatch.chdir(tmp_path)
    system = load_system("pendulum")
    assert isinstance(system, MujocoSystem)
    overfull = mujoco.MjModel.from_xml_string(balls(100, '<size memory="100K"/>'))
    states = np.zeros((8, 3, 200))
    system.model = overfull
    system.external_forces = ()
    with pytest.raises(BadFileError, match="cannot simulate this model: pushPairArena.*collide"):
        system._simulate(states, np.zeros((8, 2, 1)), system.scheme, 5, threads)
    assert not list(tmp_path.iterdir())


def test_more_contacts_than_fit_are_named_before_anybody_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    geoms = '<geom size=".1"/>' * 410
    bodies = "".join(f'<body name="{n}"><joint type="slide"/>{geoms}</body>' for n in "ab")
    crowd = f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
    with pytest.raises(
        BadFileError, match="^m.xml: MuJoCo cannot simulate.*stack.*collide"
    ) as told:
        compile_model(model(crowd))
    assert told.value.exit_code == 3
    assert len(str(told.value).splitlines()) == 1
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


def test_meshes_that_take_gigabytes_are_refused_before_they_do(monkeypatch: pytest.MonkeyPatch):
    """One file of 324 kB, used by 40 meshes: each takes 40 MB while it is compiled."""
    monkeypatch.setattr(compiled_model, "COMPILING", ProcessLimits(memory=2**29, seconds=60))
    points = np.random.default_rng(0).normal(size=(27_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    mesh = struct.pack("<4i", len(points), 0, 0, 0) + points.astype("<f4").tobytes()
    meshes = "".join(f'<mesh name="q{i}" file="q.msh"/>' for i in range(40))
    geoms = "".join(f'<geom type="mesh" mesh="q{i}"/>' for i in range(40))
    text = f"<mujoco><asset>{meshes}</asset><worldbody><body><joint/>{geoms}</body></worldbody></mujoco>"
    with pytest.raises(
        BadFileError, match="^m.xml: compiling it .*takes more than 0.5 GB of memory"
    ):
        compile_model(model(text, **{"q.msh": mesh}))
