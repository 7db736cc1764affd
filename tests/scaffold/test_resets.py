"""Random starts cover an environment's own resets, and free joints all their range; what hardly moves is named."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator import load_system
from neuroanimator.definitions.model import Definition
from neuroanimator.gym.models import reset_states
from neuroanimator.physics.rigid.model_system import ModelSystem
from neuroanimator.scaffold import teacher
from neuroanimator.scaffold.model import propose
from neuroanimator.scaffold.motion import free_spread, turns_freely
from neuroanimator.scaffold.write_toml import write_definition

PLACELESS = ("cyclic", "planar", "free")
"""Features of joints whose position does not matter, so that no start spreads them."""

TURNTABLE = """<mujoco><worldbody><geom type="plane" size="2 2 1" pos="0 0 {floor}"/>
  <body><joint name="free" type="{kind}" axis="0 1 0" {more}/><geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02"/>
  </body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    "env_id",
    [
        pytest.param("Pusher-v5", marks=pytest.mark.endurance),
        "Reacher-v5",
        "InvertedPendulum-v5",
        pytest.param("Hopper-v5", marks=pytest.mark.endurance),
    ],
)
def test_random_starts_cover_the_environments_resets(env_id: str, tmp_path: Path):
    toml, _ = write_definition(env_id, tmp_path / "env.toml")
    system = load_system(str(toml))
    assert isinstance(system, ModelSystem)
    resets = reset_states(env_id)
    assert resets is not None
    starts = system.sample_starts(np.random.default_rng(0), 2000)
    for view in system.views:
        if view.feature not in PLACELESS:
            entry = view.position_entry
            width = np.ptp(resets[:, entry])
            wanted = np.percentile(resets[:, entry], [1, 99])
            assert starts[:, entry].min() <= wanted[0] + 0.05 * width + 0.01, view.name
            assert starts[:, entry].max() >= wanted[1] - 0.05 * width - 0.01, view.name
        if view.kind in ("hinge", "slide"):
            entry = view.velocity_entry
            fastest = np.abs(starts[:, entry]).max()
            assert fastest >= np.percentile(np.abs(resets[:, entry]), 95), view.name


SLOW_AND_FAST = """<mujoco><worldbody>
  <body><joint name="arm" axis="0 1 0" damping="9"/><geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02"/>
    <body pos="0.5 0 0"><joint name="hand" type="ball" damping="1"/><geom size="0.1"/></body>
  </body></worldbody><actuator><motor joint="arm" gear="0.1" ctrlrange="-1 1"/></actuator></mujoco>"""


@pytest.mark.parametrize("speed", [0.0, pytest.param(0.1, marks=pytest.mark.endurance), 30.0])
def test_starts_are_as_fast_as_an_environments_resets(
    speed: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(teacher, "MAX_TRIAL_SECONDS", 0.02)  # the teacher does not matter here
    path = tmp_path / "thrown.xml"
    path.write_text(SLOW_AND_FAST)
    rest = np.tile([0.0, 1, 0, 0, 0], (64, 1))
    rng = np.random.default_rng(0)
    resets = np.hstack([rest, rng.uniform(-speed, speed, (64, 4))])
    usual = propose(path).definition
    thrown = propose(path, resets=resets).definition
    assert isinstance(usual, Definition)
    assert isinstance(thrown, Definition)
    for joint, first in (("arm", 5), ("hand", 6)):
        asked = np.sqrt(np.mean(resets[:, first : first + 3] ** 2, axis=0))
        velocities = np.array(thrown.sampling.velocity[joint])
        if speed:
            assert (velocities >= 0.94 * asked[: len(velocities)]).all()
        else:
            assert thrown.sampling.velocity[joint] == usual.sampling.velocity[joint]


@pytest.mark.parametrize("kind", ["hinge", "ball"])
@pytest.mark.parametrize(
    ("floor", "more", "is_free"),
    [(-2, "", True), (-0.4, "", False), (-2, 'stiffness="1"', False), (-2, 'range="0 1"', False)],
)
def test_joints_without_anything_in_their_way_start_all_the_way_round(
    kind: str, floor: float, more: str, is_free: bool
):
    model = mujoco.MjModel.from_xml_string(TURNTABLE.format(kind=kind, floor=floor, more=more))
    assert turns_freely(model, 0) == is_free
    assert (free_spread(model, 0) == pytest.approx(np.pi, abs=1e-4)) == is_free


def test_what_hardly_moves_in_trial_runs_is_named(tmp_path: Path):
    _, proposal = write_definition("Reacher-v5", tmp_path / "reacher.toml")
    assert any("target_x, target_y hardly move" in line for line in proposal.warnings)
    _, proposal = write_definition("InvertedPendulum-v5", tmp_path / "pendulum.toml")
    assert not any("hardly move" in line for line in proposal.warnings)
