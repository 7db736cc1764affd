"""Random starts cover an environment's own resets, and free joints all their range; what hardly moves is named."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from neuroanimator import load_system
from neuroanimator.gym.models import reset_positions
from neuroanimator.scaffold.motion import free_spread, turns_freely
from neuroanimator.scaffold.write_toml import write_definition
from neuroanimator.systems.rigid.model_system import ModelSystem

PLACELESS = ("cyclic", "planar", "free")
"""Features of joints whose position does not matter, so that no start spreads them."""

TURNTABLE = """<mujoco><worldbody><geom type="plane" size="2 2 1" pos="0 0 {floor}"/>
  <body><joint name="free" type="{kind}" axis="0 1 0" {more}/><geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02"/>
  </body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    "env_id",
    [
        "Pusher-v5",
        "Reacher-v5",
        "InvertedPendulum-v5",
        pytest.param("Hopper-v5", marks=pytest.mark.endurance),
    ],
)
def test_random_starts_cover_the_environments_resets(env_id: str, tmp_path: Path):
    toml, _ = write_definition(env_id, tmp_path / "env.toml")
    system = load_system(str(toml))
    assert isinstance(system, ModelSystem)
    resets = reset_positions(env_id)
    assert resets is not None
    starts = system.sample_starts(np.random.default_rng(0), 2000)
    for view in system.views:
        if view.feature not in PLACELESS:
            entry = view.position_entry
            width = np.ptp(resets[:, entry])
            wanted = np.percentile(resets[:, entry], [1, 99])
            assert starts[:, entry].min() <= wanted[0] + 0.05 * width + 0.01, view.name
            assert starts[:, entry].max() >= wanted[1] - 0.05 * width - 0.01, view.name


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
