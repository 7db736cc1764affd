"""Systems without bodies are drawn as gauges: a pointer for each angle, a slider for each other number."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import Cli

import neuroanimator as na
from neuroanimator.animation.gauges import REACH, as_gauges
from neuroanimator.scaffold.write_toml import write_definition

ROOM = """\
import numpy as np

STEP = 0.05
STATE = {"cart": "m", "angle": "rad", "speed": "m/s", "spin": "rad/s", "room": ("K", 2)}
CONTROL = {"force": ("N", -1.0, 1.0)}
REST = {"room": [290.0, 300.0]}
SPREAD = {"cart": 1.0, "angle": 3.14, "speed": 1.0, "spin": 2.0, "room": 5.0}


def step(state, control, dt):
    cart, angle, speed, spin, first, second = state
    speed = speed + dt * (control[0] - speed)
    spin = spin - dt * (9.81 * np.sin(angle) + speed)
    flow = dt * (second - first)
    return np.array([cart + dt * speed, angle + dt * spin, speed, spin, first + flow, second - flow])
"""


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> na.Emulator:
    folder = tmp_path_factory.mktemp("gauges")
    (folder / "room.py").write_text(ROOM)
    toml, _ = write_definition(str(folder / "room.py"))
    system = na.load_system(str(toml))
    config = na.DatasetConfig(
        system=system.name,
        definition=system.definition_text,
        substeps=2,
        count=612,
        samples_per_run=36,
    )
    na.generate(config, folder / "data")
    settings = na.TrainingConfig(updates=250, widths=(8,), batch=64)
    return na.train(
        na.read_transitions(folder / "data"), settings, folder / "room.emulator.safetensors"
    )


def motion(emulator: na.Emulator, seed: int = 0) -> na.Clip:
    rng = np.random.default_rng(seed)
    states = emulator.rest + rng.normal(size=(12, emulator.state.size))
    return na.make_clip(emulator, states)


def test_pointers_turn_by_the_angle_and_knobs_lie_where_the_number_does_in_its_range(
    emulator: na.Emulator,
):
    clip = motion(emulator)
    gauges = as_gauges(clip, emulator)
    names = [bone.name for bone in gauges.skeleton.bones]
    # Rates are seen as motion: neither speed nor spin has a gauge.
    assert names[1::2] == ["cart", "angle", "room.0", "room.1"]
    positions, orientations = gauges.skeleton.world_poses(gauges.states)
    angle = clip.states[:, emulator.state.index("angle")][:, 0]
    turned = 2 * np.arctan2(-orientations[:, 3, 2], orientations[:, 3, 0])
    np.testing.assert_allclose(np.cos(turned), np.cos(angle), atol=1e-9)
    np.testing.assert_allclose(np.sin(turned), np.sin(angle), atol=1e-9)
    room = clip.states[:, -1]
    heights = positions[:, 7, 2] - positions[:, 6, 2]
    share = (room - room.min()) / (room.max() - room.min())
    np.testing.assert_allclose(heights, REACH * (2 * share - 1), atol=1e-9)


def test_clips_seen_together_share_their_ranges_and_a_number_that_never_changes_is_in_the_middle(
    emulator: na.Emulator,
):
    clip = motion(emulator)
    other = motion(emulator, seed=1)
    ghost = as_gauges(other, emulator, ranges_from=clip)
    assert ghost.skeleton == as_gauges(clip, emulator).skeleton
    own = as_gauges(other, emulator)
    assert np.ptp(own.states[:, 3]) == pytest.approx(2 * REACH)
    assert not np.allclose(own.states, ghost.states)
    still = na.make_clip(emulator, np.tile(emulator.rest, (5, 1)))
    np.testing.assert_array_equal(as_gauges(still, emulator).states, 0.0)


def test_a_clip_without_bodies_is_refused_by_name_and_its_gauges_are_written(
    emulator: na.Emulator, tmp_path: Path
):
    clip = motion(emulator)
    for write in (na.write_glb, na.write_video):
        with pytest.raises(na.NeuroAnimatorError, match="as_gauges"):
            write(clip, tmp_path / "clip.glb")
    na.write_glb(na.as_gauges(clip, emulator), tmp_path / "clip.glb")
    content = (tmp_path / "clip.glb").read_bytes()
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    assert {"cart", "angle", "room.0", "room.1"} < {node["name"] for node in document["nodes"]}


def test_animate_draws_gauges_and_writes_the_numbers_themselves(
    emulator: na.Emulator, cli: Cli, tmp_path: Path
):
    emulator.save(tmp_path / "room.emulator.safetensors")
    result = cli(
        "animate", "room.emulator.safetensors", "--out", "a.glb", "--out", "a.csv", cwd=tmp_path
    )
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "a.csv").read_text().startswith("time s,cart[0] m,angle[0] rad")
    assert (tmp_path / "a.glb").stat().st_size > 5000
